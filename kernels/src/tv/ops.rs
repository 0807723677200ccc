//! The smoothness penalty as a differentiable op on tensors. The forward pass computes the gradient too.

use super::{TvGrads, TvKind, TvWeights, tv};
use crate::backend::{CpuBackend, zeros};
use crate::field::{FieldParams, FieldShape};
use crate::scale::{ScaleOps, scaled};
use crate::tensors::{like, recorded};
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
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

impl<B: CpuBackend> TvOps for B {
    fn tv_forward(
        planes: FloatTensor<Self>,
        lines: FloatTensor<Self>,
        times: FloatTensor<Self>,
        shape: FieldShape,
        kind: TvKind,
        weights: TvWeights,
    ) -> TvForward<Self> {
        let inputs = [&planes, &lines, &times];
        let values = inputs.map(B::values);
        let mut grads = values.each_ref().map(|values| zeros(values.len()));
        let params = FieldParams { planes: &values[0], lines: &values[1], times: &values[2] };
        let [of_planes, of_lines, of_times] = &mut grads;
        let out = TvGrads { planes: of_planes, lines: of_lines, times: of_times };
        let value = tv(params, &shape, kind, weights, out);
        let value = B::tensor(vec![value as f32], [1], &planes.device());
        let [planes, lines, times] = like::<B, _>(inputs, grads);
        TvForward { value, planes, lines, times }
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
        let grads = [out.planes, out.lines, out.times];
        let value = recorded::<B, C, _, _>([n_planes, n_lines, n_times], grads, |_| out.value, scaled::<B, _>);
        TvForward { value, planes, lines, times }
    }
}
