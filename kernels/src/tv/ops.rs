//! The smoothness penalty as a differentiable op on tensors. The forward pass computes the gradient too.

use super::{TvGrads, TvKind, TvWeights, tv};
use crate::backend::{CpuBackend, for_cpu_backends, zeros};
use crate::field::{FieldParams, FieldShape};
use crate::scale::ScaleOps;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, AutodiffBackend, Backend, Dispatch, ExtensionType, TensorMetadata, backend_extension};
use burn::tensor::Tensor;

/// The penalty and its gradients on a backend.
#[derive(ExtensionType)]
pub struct TvForward<B: Backend> {
    /// Weighted penalty `[1]`.
    pub value: FloatTensor<B>,
    /// Gradient of the planes, flat.
    pub planes: FloatTensor<B>,
    /// Gradient of the lines, flat.
    pub lines: FloatTensor<B>,
    /// Gradient of the times, flat.
    pub times: FloatTensor<B>,
}

/// The backend side of [`total_variation`].
#[backend_extension(Autodiff, NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"), LibTorch: cfg(feature = "tch"))]
pub trait TvOps: Backend {
    /// Computes the weighted penalty with its gradients.
    fn tv_forward(
        planes: FloatTensor<Self>,
        lines: FloatTensor<Self>,
        times: FloatTensor<Self>,
        shape: FieldShape,
        kind: TvKind,
        weights: TvWeights,
    ) -> TvForward<Self>;
}

/// Returns the weighted total variation of the field's parameters (the paper's equation 6), `[1]`, differentiable.
///
/// # Panics
/// If `shape` is invalid, or a buffer does not fit it.
pub fn total_variation(
    planes: Tensor<1>,
    lines: Tensor<1>,
    times: Tensor<1>,
    shape: &FieldShape,
    kind: TvKind,
    weights: TvWeights,
) -> Tensor<1> {
    shape.check([&planes, &lines, &times].map(|buffer| buffer.dims()[0]));
    let (planes, lines, times) = (planes.into_dispatch(), lines.into_dispatch(), times.into_dispatch());
    Tensor::from_dispatch(Dispatch::tv_forward(planes, lines, times, shape.clone(), kind, weights).value)
}

fn cpu_forward<B: CpuBackend>(
    inputs: [&FloatTensor<B>; 3],
    shape: &FieldShape,
    kind: TvKind,
    weights: TvWeights,
) -> TvForward<B> {
    let [planes, lines, times] = inputs;
    let device = planes.device();
    let values = (B::values(planes), B::values(lines), B::values(times));
    let params = FieldParams { planes: &values.0, lines: &values.1, times: &values.2 };
    let mut grads = (zeros(params.planes.len()), zeros(params.lines.len()), zeros(params.times.len()));
    let out = TvGrads { planes: &mut grads.0, lines: &mut grads.1, times: &mut grads.2 };
    let value = tv(params, shape, kind, weights, out);
    TvForward {
        value: B::tensor(vec![value as f32], [1], &device),
        planes: B::tensor(grads.0, planes.shape(), &device),
        lines: B::tensor(grads.1, lines.shape(), &device),
        times: B::tensor(grads.2, times.shape(), &device),
    }
}

macro_rules! bind {
    ($backend:ty) => {
        impl TvOps for $backend {
            fn tv_forward(
                planes: FloatTensor<Self>,
                lines: FloatTensor<Self>,
                times: FloatTensor<Self>,
                shape: FieldShape,
                kind: TvKind,
                weights: TvWeights,
            ) -> TvForward<Self> {
                cpu_forward::<Self>([&planes, &lines, &times], &shape, kind, weights)
            }
        }
    };
}

for_cpu_backends!(bind);

#[derive(Debug)]
struct TvBackward;

impl<B: TvOps + ScaleOps> Backward<B, 3> for TvBackward {
    type State = [FloatTensor<B>; 3];

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _checkpointer: &mut Checkpointer) {
        let upstream = grads.consume::<B>(&ops.node);
        for (parent, grad) in ops.parents.into_iter().zip(ops.state) {
            if let Some(node) = parent {
                grads.register::<B>(node.id, B::scaled(grad, upstream.clone()));
            }
        }
    }
}

impl<B: TvOps + ScaleOps, C: CheckpointStrategy> TvOps for Autodiff<B, C> {
    fn tv_forward(
        planes: FloatTensor<Self>,
        lines: FloatTensor<Self>,
        times: FloatTensor<Self>,
        shape: FieldShape,
        kind: TvKind,
        weights: TvWeights,
    ) -> TvForward<Self> {
        let (planes, n_planes) = planes.into_parts();
        let (lines, n_lines) = lines.into_parts();
        let (times, n_times) = times.into_parts();
        let out = B::tv_forward(planes, lines, times, shape, kind, weights);
        let plain = <Self as AutodiffBackend>::from_inner;
        let (planes, lines, times) = (plain(out.planes.clone()), plain(out.lines.clone()), plain(out.times.clone()));
        let value = match TvBackward.prepare::<C>([n_planes, n_lines, n_times]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish([out.planes, out.lines, out.times], out.value),
            OpsKind::UnTracked(prep) => prep.finish(out.value),
        };
        TvForward { value, planes, lines, times }
    }
}
