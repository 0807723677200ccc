//! Adam as an op on tensors: parameter and moments in, updated ones out, in the same memory where the
//! backend allows it. Not differentiable; call it on tensors without gradients.

use super::cpu::first_non_finite;
use super::{AdamStep, adam_step};
use crate::backend::CpuBackend;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, ExtensionType, TensorMetadata, backend_extension};
use burn::tensor::Tensor;

/// Result of a step on a backend.
#[derive(ExtensionType)]
pub struct AdamOutput<B: Backend> {
    /// Updated parameter.
    pub param: FloatTensor<B>,
    /// Updated first moment.
    pub moment_1: FloatTensor<B>,
    /// Updated second moment.
    pub moment_2: FloatTensor<B>,
    /// First non-finite element; if present, nothing was updated. A GPU never reports one.
    pub non_finite: Option<NonFinite>,
}

/// An element that was NaN or infinite before the step, or so large (1.8e19) that its square is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NonFinite {
    /// In the gradient.
    Gradient(usize),
    /// In the parameter itself.
    Parameter(usize),
}

/// The backend side of [`adam`].
#[backend_extension(NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"), LibTorch: cfg(feature = "tch"))]
pub trait AdamOps: Backend {
    /// Runs one step.
    fn adam(
        param: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        moment_1: FloatTensor<Self>,
        moment_2: FloatTensor<Self>,
        step: AdamStep,
    ) -> AdamOutput<Self>;
}

/// A parameter with its moments, all of one shape.
#[derive(Clone, Debug)]
pub struct AdamTensors<const D: usize> {
    /// The parameter.
    pub param: Tensor<D>,
    /// Running mean of the gradient.
    pub moment_1: Tensor<D>,
    /// Running mean of the squared gradient.
    pub moment_2: Tensor<D>,
}

/// Runs one Adam step (PyTorch's semantics: epsilon outside the root, after bias correction).
///
/// The second result is the first element of the parameter or of its gradient that is [`NonFinite`], if any; then
/// nothing was updated and the caller should stop. On a GPU it is always `None`.
///
/// # Panics
/// If the shapes differ.
pub fn adam<const D: usize>(
    tensors: AdamTensors<D>,
    grad: Tensor<D>,
    step: AdamStep,
) -> (AdamTensors<D>, Option<NonFinite>) {
    for (name, tensor) in
        [("gradient", &grad), ("first moment", &tensors.moment_1), ("second moment", &tensors.moment_2)]
    {
        assert_eq!(tensor.dims(), tensors.param.dims(), "adam: the {name} has the parameter's shape");
    }
    let out = Dispatch::adam(
        tensors.param.into_dispatch(),
        grad.into_dispatch(),
        tensors.moment_1.into_dispatch(),
        tensors.moment_2.into_dispatch(),
        step,
    );
    let tensors = AdamTensors {
        param: Tensor::from_dispatch(out.param),
        moment_1: Tensor::from_dispatch(out.moment_1),
        moment_2: Tensor::from_dispatch(out.moment_2),
    };
    (tensors, out.non_finite)
}

impl<B: CpuBackend> AdamOps for B {
    fn adam(
        param: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        moment_1: FloatTensor<Self>,
        moment_2: FloatTensor<Self>,
        step: AdamStep,
    ) -> AdamOutput<Self> {
        let (shape, device) = (param.shape(), param.device());
        let [mut param, mut m, mut v] = [param, moment_1, moment_2].map(B::into_values);
        let non_finite = first_non_finite(&param).map(NonFinite::Parameter).or_else(|| {
            let result = adam_step(&mut param, &B::values(&grad), &mut m, &mut v, step);
            result.err().map(|e| NonFinite::Gradient(e.index))
        });
        let [param, moment_1, moment_2] = [param, m, v].map(|values| B::tensor(values, shape.clone(), &device));
        AdamOutput { param, moment_1, moment_2, non_finite }
    }
}
