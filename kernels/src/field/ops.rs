//! The field as a differentiable op on tensors for every backend, with its implementation for those in host memory.

use super::cpu::{backward, forward};
use super::params::{FieldGrads, FieldParams};
use super::shape::FieldShape;
use crate::backend::{CpuBackend, for_cpu_backends, zeros};
use crate::tensors::{op_tensors, register};
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, TensorMetadata, backend_extension};
use burn::tensor::Tensor;
use rayon::prelude::*;

op_tensors! {
    /// The inputs of [`field`] on a backend, or the gradient with respect to each of them.
    FieldTensors[4] {
        /// `[planes_len]`
        planes,
        /// `[lines_len]`
        lines,
        /// `[times_len]`
        times,
        /// `[N, 3]`
        points,
    }
}

/// The backend side of [`field`].
#[backend_extension(Autodiff, NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"), LibTorch: cfg(feature = "tch"))]
pub trait FieldOps: Backend {
    /// Returns the features `[N, levels * R]`.
    fn field_forward(#[extension_type] inputs: FieldTensors<Self>, shape: FieldShape, time: f32) -> FloatTensor<Self>;
}

/// The backward side of [`field`], for backends that compute. The autodiff backend does not implement it, so a second
/// derivative does not compile.
pub trait FieldBackwardOps: Backend {
    /// Returns the gradients for `grad` `[N, levels * R]`.
    fn field_backward(
        inputs: FieldTensors<Self>,
        grad: FloatTensor<Self>,
        shape: FieldShape,
        time: f32,
    ) -> FieldTensors<Self>;
}

/// Samples the factorised space-time field (the paper's T4, before the decoder).
///
/// `planes`, `lines` and `times` are the flat parameter buffers that [`FieldShape`] describes, `points`
/// `[N, 3]` lie in [-1, 1] and `time` in [0, 1] spans all the time knots. Returns `[N, levels * R]`.
///
/// # Panics
/// If `shape` is invalid, or a buffer does not fit it.
pub fn field(
    planes: Tensor<1>,
    lines: Tensor<1>,
    times: Tensor<1>,
    points: Tensor<2>,
    shape: &FieldShape,
    time: f32,
) -> Tensor<2> {
    shape.check([&planes, &lines, &times].map(|buffer| buffer.dims()[0]));
    let [n, three] = points.dims();
    assert_eq!(three, 3, "field: points are [N, 3], got [{n}, {three}]");
    let inputs = FieldTensors {
        planes: planes.into_dispatch(),
        lines: lines.into_dispatch(),
        times: times.into_dispatch(),
        points: points.into_dispatch(),
    };
    Tensor::from_dispatch(Dispatch::field_forward(inputs, shape.clone(), time))
}

fn cpu_forward<B: CpuBackend>(inputs: &FieldTensors<B>, shape: &FieldShape, time: f32) -> FloatTensor<B> {
    let n = inputs.points.shape()[0];
    let mut features = zeros(n * shape.features_len());
    let [planes, lines, times, points] = inputs.as_array().map(B::values);
    forward(shape, FieldParams { planes: &planes, lines: &lines, times: &times }, &points, time, &mut features);
    B::tensor(features, [n, shape.features_len()], &inputs.points.device())
}

fn cpu_backward<B: CpuBackend>(
    inputs: &FieldTensors<B>,
    grad: &FloatTensor<B>,
    shape: &FieldShape,
    time: f32,
) -> FieldTensors<B> {
    let device = inputs.points.device();
    let n = inputs.points.shape()[0];
    let [planes, lines, times, points] = inputs.as_array().map(B::values);
    let params = FieldParams { planes: &planes, lines: &lines, times: &times };
    let mut grads = (zeros(params.planes.len()), zeros(params.lines.len()), zeros(params.times.len()), zeros(3 * n));
    let out = FieldGrads { planes: &mut grads.0, lines: &mut grads.1, times: &mut grads.2, points: &mut grads.3 };
    let grad = B::values(grad);
    // Gaussians seen by no pixel have a gradient of zero: about half of them in a translucent scene
    let rows = grad.par_chunks_exact(shape.features_len()).with_min_len(1024);
    let active: Vec<bool> = rows.map(|row| row.iter().any(|&g| g != 0.0)).collect();
    backward(shape, params, &points, time, &grad, Some(&active), out);
    FieldTensors {
        planes: B::tensor(grads.0, inputs.planes.shape(), &device),
        lines: B::tensor(grads.1, inputs.lines.shape(), &device),
        times: B::tensor(grads.2, inputs.times.shape(), &device),
        points: B::tensor(grads.3, [n, 3], &device),
    }
}

macro_rules! bind {
    ($backend:ty) => {
        impl FieldOps for $backend {
            fn field_forward(inputs: FieldTensors<Self>, shape: FieldShape, time: f32) -> FloatTensor<Self> {
                cpu_forward::<Self>(&inputs, &shape, time)
            }
        }

        impl FieldBackwardOps for $backend {
            fn field_backward(
                inputs: FieldTensors<Self>,
                grad: FloatTensor<Self>,
                shape: FieldShape,
                time: f32,
            ) -> FieldTensors<Self> {
                cpu_backward::<Self>(&inputs, &grad, &shape, time)
            }
        }
    };
}

for_cpu_backends!(bind);

#[derive(Clone, Debug)]
struct State<B: FieldBackwardOps> {
    inputs: FieldTensors<B>,
    shape: FieldShape,
    time: f32,
}

#[derive(Debug)]
struct FieldBackward;

impl<B: FieldBackwardOps> Backward<B, 4> for FieldBackward {
    type State = State<B>;

    fn backward(self, ops: Ops<Self::State, 4>, grads: &mut Gradients, _checkpointer: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let State { inputs, shape, time } = ops.state;
        let out = B::field_backward(inputs, grad, shape, time);
        register::<B, 4>(grads, ops.parents.map(|p| p.map(|node| node.id)), out.into_array());
    }
}

impl<B: FieldOps + FieldBackwardOps, C: CheckpointStrategy> FieldOps for Autodiff<B, C> {
    fn field_forward(inputs: FieldTensors<Self>, shape: FieldShape, time: f32) -> FloatTensor<Self> {
        let (inputs, nodes) = inputs.into_parts();
        let out = B::field_forward(inputs.clone(), shape.clone(), time);
        match FieldBackward.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(State { inputs, shape, time }, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }
}
