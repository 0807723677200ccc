//! Opacities by path length as a differentiable op on tensors, for every backend.

use super::MAX_EXPONENT;
use super::cpu::{self, Gradients, Seen};
use crate::backend::{CpuBackend, for_cpu_backends};
use crate::tensors::{op_tensors, register};
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients as Grads;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
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
#[must_use]
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
fn lent<B: CpuBackend, R>(inputs: &PathTensors<B>, eye: [f32; 3], exponent: f32, f: impl FnOnce(&Seen<'_>) -> R) -> R {
    let [means, rotations, log_scales, logits] = inputs.as_array().map(B::values);
    f(&Seen { means: &means, rotations: &rotations, log_scales: &log_scales, logits: &logits, eye, exponent })
}

fn cpu_backward<B: CpuBackend>(
    inputs: &PathTensors<B>,
    grad: &FloatTensor<B>,
    eye: [f32; 3],
    exponent: f32,
) -> PathTensors<B> {
    let grad = B::values(grad);
    let Gradients { means, rotations, log_scales, logits } =
        lent(inputs, eye, exponent, |seen| cpu::backward(seen, &grad));
    let device = inputs.logits.device();
    let like = |values: Vec<f32>, of: &FloatTensor<B>| B::tensor(values, of.shape(), &device);
    PathTensors {
        means: like(means, &inputs.means),
        rotations: like(rotations, &inputs.rotations),
        log_scales: like(log_scales, &inputs.log_scales),
        logits: like(logits, &inputs.logits),
    }
}

macro_rules! bind {
    ($backend:ty) => {
        impl PathOps for $backend {
            fn path_forward(inputs: PathTensors<Self>, eye: [f32; 3], exponent: f32) -> FloatTensor<Self> {
                let out = lent(&inputs, eye, exponent, cpu::forward);
                Self::tensor(out, inputs.logits.shape(), &inputs.logits.device())
            }
        }

        impl PathBackwardOps for $backend {
            fn path_backward(
                inputs: PathTensors<Self>,
                grad: FloatTensor<Self>,
                eye: [f32; 3],
                exponent: f32,
            ) -> PathTensors<Self> {
                cpu_backward::<Self>(&inputs, &grad, eye, exponent)
            }
        }
    };
}

for_cpu_backends!(bind);

#[derive(Clone, Debug)]
struct State<B: PathBackwardOps> {
    inputs: PathTensors<B>,
    eye: [f32; 3],
    exponent: f32,
}

#[derive(Debug)]
struct PathBackward;

impl<B: PathBackwardOps> Backward<B, 4> for PathBackward {
    type State = State<B>;

    fn backward(self, ops: Ops<Self::State, 4>, grads: &mut Grads, _checkpointer: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let State { inputs, eye, exponent } = ops.state;
        let out = B::path_backward(inputs, grad, eye, exponent);
        register::<B, 4>(grads, ops.parents.map(|p| p.map(|node| node.id)), out.into_array());
    }
}

impl<B: PathOps + PathBackwardOps, C: CheckpointStrategy> PathOps for Autodiff<B, C> {
    fn path_forward(inputs: PathTensors<Self>, eye: [f32; 3], exponent: f32) -> FloatTensor<Self> {
        let (inputs, nodes) = inputs.into_parts();
        match PathBackward.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let out = B::path_forward(inputs.clone(), eye, exponent);
                prep.finish(State::<B> { inputs, eye, exponent }, out)
            }
            OpsKind::UnTracked(prep) => prep.finish(B::path_forward(inputs, eye, exponent)),
        }
    }
}
