//! The field as a differentiable op on tensors, for every backend in host memory.

use super::cpu::{backward, forward};
use super::params::{FieldGrads, FieldParams};
use super::shape::FieldShape;
use crate::backend::CpuBackend;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, ExtensionType, TensorMetadata, backend_extension};
use burn::tensor::Tensor;
use rayon::prelude::*;

/// Gradients of every input of [`field`].
#[derive(ExtensionType)]
pub struct FieldGradients<B: Backend> {
    /// `[planes_len]`
    pub planes: FloatTensor<B>,
    /// `[lines_len]`
    pub lines: FloatTensor<B>,
    /// `[times_len]`
    pub times: FloatTensor<B>,
    /// `[N, 3]`
    pub points: FloatTensor<B>,
}

/// The backend side of [`field`].
#[backend_extension(Autodiff, NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"), LibTorch: cfg(feature = "tch"))]
pub trait FieldOps: Backend {
    /// Features `[N, levels * R]`.
    fn field_forward(
        planes: FloatTensor<Self>,
        lines: FloatTensor<Self>,
        times: FloatTensor<Self>,
        points: FloatTensor<Self>,
        shape: FieldShape,
        time: f32,
    ) -> FloatTensor<Self>;
}

/// The backward side of [`field`], of backends that compute. One that records gradients has none of its own: a second
/// derivative does not compile.
pub trait FieldBackwardOps: Backend {
    /// Gradients for `grad` `[N, levels * R]`.
    fn field_backward(
        planes: FloatTensor<Self>,
        lines: FloatTensor<Self>,
        times: FloatTensor<Self>,
        points: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        shape: FieldShape,
        time: f32,
    ) -> FieldGradients<Self>;
}

/// Samples the factorised space-time field (the paper's T4, before the decoder).
///
/// `planes`, `lines` and `times` are the flat parameter buffers that [`FieldShape`] describes, `points`
/// `[N, 3]` lie in [-1, 1] and `time` in [0, 1] spans all the time knots. Returns `[N, levels * R]`.
///
/// # Panics
/// If a buffer does not fit `shape`.
pub fn field(
    planes: Tensor<1>,
    lines: Tensor<1>,
    times: Tensor<1>,
    points: Tensor<2>,
    shape: &FieldShape,
    time: f32,
) -> Tensor<2> {
    Tensor::from_dispatch(Dispatch::field_forward(
        planes.into_dispatch(),
        lines.into_dispatch(),
        times.into_dispatch(),
        points.into_dispatch(),
        shape.clone(),
        time,
    ))
}

fn cpu_forward<B: CpuBackend>(inputs: [&FloatTensor<B>; 4], shape: &FieldShape, time: f32) -> FloatTensor<B> {
    let [planes, lines, times, points] = inputs;
    let n = points.shape()[0];
    let mut features = vec![0.0; n * shape.features_len()];
    let params = (B::values(planes), B::values(lines), B::values(times));
    let params = FieldParams { planes: &params.0, lines: &params.1, times: &params.2 };
    forward(shape, params, &B::values(points), time, &mut features);
    B::tensor(features, [n, shape.features_len()], &points.device())
}

fn cpu_backward<B: CpuBackend>(
    inputs: [&FloatTensor<B>; 4],
    grad: &FloatTensor<B>,
    shape: &FieldShape,
    time: f32,
) -> FieldGradients<B> {
    let [planes, lines, times, points] = inputs;
    let device = points.device();
    let n = points.shape()[0];
    let values = (B::values(planes), B::values(lines), B::values(times));
    let params = FieldParams { planes: &values.0, lines: &values.1, times: &values.2 };
    let mut grads = (
        vec![0.0; params.planes.len()],
        vec![0.0; params.lines.len()],
        vec![0.0; params.times.len()],
        vec![0.0; 3 * n],
    );
    let out = FieldGrads { planes: &mut grads.0, lines: &mut grads.1, times: &mut grads.2, points: &mut grads.3 };
    let grad = B::values(grad);
    // Gaussians that no pixel saw have a gradient of zero: about half of them in a translucent scene
    let rows = grad.par_chunks_exact(shape.features_len()).with_min_len(1024);
    let active: Vec<bool> = rows.map(|row| row.iter().any(|&g| g != 0.0)).collect();
    backward(shape, params, &B::values(points), time, &grad, Some(&active), out);
    FieldGradients {
        planes: B::tensor(grads.0, planes.shape(), &device),
        lines: B::tensor(grads.1, lines.shape(), &device),
        times: B::tensor(grads.2, times.shape(), &device),
        points: B::tensor(grads.3, [n, 3], &device),
    }
}

macro_rules! bind {
    ($backend:ty) => {
        impl FieldOps for $backend {
            fn field_forward(
                planes: FloatTensor<Self>,
                lines: FloatTensor<Self>,
                times: FloatTensor<Self>,
                points: FloatTensor<Self>,
                shape: FieldShape,
                time: f32,
            ) -> FloatTensor<Self> {
                cpu_forward::<Self>([&planes, &lines, &times, &points], &shape, time)
            }
        }

        impl FieldBackwardOps for $backend {
            fn field_backward(
                planes: FloatTensor<Self>,
                lines: FloatTensor<Self>,
                times: FloatTensor<Self>,
                points: FloatTensor<Self>,
                grad: FloatTensor<Self>,
                shape: FieldShape,
                time: f32,
            ) -> FieldGradients<Self> {
                cpu_backward::<Self>([&planes, &lines, &times, &points], &grad, &shape, time)
            }
        }
    };
}

#[cfg(feature = "ndarray")]
bind!(burn_ndarray::NdArray);
#[cfg(feature = "flex")]
bind!(burn_flex::Flex);
#[cfg(feature = "tch")]
bind!(burn_tch::LibTorch);

#[derive(Clone, Debug)]
struct State<B: FieldBackwardOps> {
    planes: FloatTensor<B>,
    lines: FloatTensor<B>,
    times: FloatTensor<B>,
    points: FloatTensor<B>,
    shape: FieldShape,
    time: f32,
}

#[derive(Debug)]
struct FieldBackward;

impl<B: FieldBackwardOps> Backward<B, 4> for FieldBackward {
    type State = State<B>;

    fn backward(self, ops: Ops<Self::State, 4>, grads: &mut Gradients, _checkpointer: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let s = ops.state;
        let out = B::field_backward(s.planes, s.lines, s.times, s.points, grad, s.shape, s.time);
        for (parent, grad) in ops.parents.into_iter().zip([out.planes, out.lines, out.times, out.points]) {
            if let Some(node) = parent {
                grads.register::<B>(node.id, grad);
            }
        }
    }
}

impl<B: FieldOps + FieldBackwardOps, C: CheckpointStrategy> FieldOps for Autodiff<B, C> {
    fn field_forward(
        planes: FloatTensor<Self>,
        lines: FloatTensor<Self>,
        times: FloatTensor<Self>,
        points: FloatTensor<Self>,
        shape: FieldShape,
        time: f32,
    ) -> FloatTensor<Self> {
        let (planes, n_planes) = planes.into_parts();
        let (lines, n_lines) = lines.into_parts();
        let (times, n_times) = times.into_parts();
        let (points, n_points) = points.into_parts();
        let out = B::field_forward(planes.clone(), lines.clone(), times.clone(), points.clone(), shape.clone(), time);
        match FieldBackward.prepare::<C>([n_planes, n_lines, n_times, n_points]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(State { planes, lines, times, points, shape, time }, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }
}
