//! Opacities by path length as a differentiable op on tensors, for every backend.

use super::MAX_EXPONENT;
use super::cpu::{self, PathOpacityArrays};
use crate::backend::CpuBackend;
use crate::tensors::{like, op_tensors, recorded};
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, TensorMetadata, backend_extension};
use burn::tensor::Tensor;

op_tensors! {
    /// The tensors of [`path_opacity`] on a backend, or the gradient with respect to each of them.
    PathTensors[4] {
        /// `[N, 3]`
        means,
        /// `[N, 4]`
        rotations,
        /// `[N, 3]`
        log_scales,
        /// `[N]`
        logits,
    }
}

/// The backend side of [`path_opacity`].
#[backend_extension(Autodiff, NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"), LibTorch: cfg(feature = "tch"))]
pub trait PathOps: Backend {
    /// Returns the logits `[N]` as the eye sees them.
    fn path_forward(#[extension_type] inputs: PathTensors<Self>, eye: [f32; 3], exponent: f32) -> FloatTensor<Self>;
}

/// The backward side of [`path_opacity`], for backends that compute. The autodiff backend does not implement it, so a
/// second derivative does not compile.
pub trait PathBackwardOps: Backend {
    /// Returns the gradients of a loss whose gradient with respect to the result is `grad` `[N]`.
    fn path_backward(
        inputs: PathTensors<Self>,
        grad: FloatTensor<Self>,
        eye: [f32; 3],
        exponent: f32,
    ) -> PathTensors<Self>;
}

/// Returns the opacity logits `[N]` of Gaussians at `means` `[N, 3]` with `rotations` `[N, 4]` (w, x, y, z, of any
/// length) and `log_scales` `[N, 3]`, seen from `eye` (scene units), from their base logits `[N]`; the formula is that of
/// [the module](super). Gradients reach all four. A Gaussian whose result is not finite passes no gradient on.
///
/// # Panics
/// If the shapes disagree or the exponent is not in `0..=MAX_EXPONENT`.
pub fn path_opacity(
    means: Tensor<2>,
    rotations: Tensor<2>,
    log_scales: Tensor<2>,
    logits: Tensor<1>,
    eye: [f32; 3],
    exponent: f32,
) -> Tensor<1> {
    let [n] = logits.dims();
    assert_eq!(means.dims(), [n, 3], "path_opacity: means are [N, 3] with N = {n}");
    assert_eq!(rotations.dims(), [n, 4], "path_opacity: rotations are [N, 4] with N = {n}");
    assert_eq!(log_scales.dims(), [n, 3], "path_opacity: log_scales are [N, 3] with N = {n}");
    assert!(
        (0.0..=MAX_EXPONENT).contains(&exponent),
        "path_opacity: the exponent is {exponent}, expected 0 to {MAX_EXPONENT}"
    );
    let inputs = PathTensors {
        means: means.into_dispatch(),
        rotations: rotations.into_dispatch(),
        log_scales: log_scales.into_dispatch(),
        logits: logits.into_dispatch(),
    };
    Tensor::from_dispatch(Dispatch::path_forward(inputs, eye, exponent))
}

/// Passes the arrays, borrowed where possible, to `f`.
fn lent<B: CpuBackend, R>(
    inputs: &PathTensors<B>,
    eye: [f32; 3],
    exponent: f32,
    f: impl FnOnce(&PathOpacityArrays<'_>) -> R,
) -> R {
    let [means, rotations, log_scales, logits] = inputs.as_array().map(B::values);
    f(&PathOpacityArrays {
        means: &means,
        rotations: &rotations,
        log_scales: &log_scales,
        logits: &logits,
        eye,
        exponent,
    })
}

impl<B: CpuBackend> PathOps for B {
    fn path_forward(inputs: PathTensors<Self>, eye: [f32; 3], exponent: f32) -> FloatTensor<Self> {
        let out = lent(&inputs, eye, exponent, cpu::forward);
        B::tensor(out, inputs.logits.shape(), &inputs.logits.device())
    }
}

impl<B: CpuBackend> PathBackwardOps for B {
    fn path_backward(
        inputs: PathTensors<Self>,
        grad: FloatTensor<Self>,
        eye: [f32; 3],
        exponent: f32,
    ) -> PathTensors<Self> {
        let grads = lent(&inputs, eye, exponent, |seen| cpu::backward(seen, &B::values(&grad)));
        like::<B, _>(inputs.as_array(), grads).into()
    }
}

impl<B: PathOps + PathBackwardOps, C: CheckpointStrategy> PathOps for Autodiff<B, C> {
    fn path_forward(inputs: PathTensors<Self>, eye: [f32; 3], exponent: f32) -> FloatTensor<Self> {
        let (inputs, nodes) = inputs.into_parts();
        recorded::<B, C, _, _>(
            nodes,
            (inputs, eye, exponent),
            |(inputs, eye, exponent)| B::path_forward(inputs, eye, exponent),
            |(inputs, eye, exponent), grad| B::path_backward(inputs, grad, eye, exponent).into_array(),
        )
    }
}
