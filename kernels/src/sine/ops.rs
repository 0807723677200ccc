//! Sines as a differentiable op on tensors, for every backend.

use super::cpu::{backward, forward};
use crate::backend::CpuBackend;
use crate::tensors::{like, op_tensors, recorded};
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, TensorMetadata, backend_extension};
use burn::tensor::Tensor;

op_tensors! {
    /// The inputs of [`sine`] on a backend, or the gradient with respect to each of them.
    SineTensors[2] {
        /// `[N, W]`
        x,
        /// `[W]`
        bias,
    }
}

/// The backend side of [`sine`].
#[backend_extension(Autodiff, NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"), LibTorch: cfg(feature = "tch"))]
pub trait SineOps: Backend {
    /// Returns `sin(omega (x + bias))`, `[N, W]`.
    fn sine_forward(#[extension_type] inputs: SineTensors<Self>, omega: f32) -> FloatTensor<Self>;
}

/// The backward side of [`sine`], for backends that compute. The autodiff backend does not implement it, so a second
/// derivative does not compile.
pub trait SineBackwardOps: Backend {
    /// Returns the gradients for `grad` `[N, W]`.
    fn sine_backward(inputs: SineTensors<Self>, grad: FloatTensor<Self>, omega: f32) -> SineTensors<Self>;
}

/// Returns `sin(omega (x + bias))` of `x` `[N, W]` with `bias` `[W]`, differentiable with respect to both.
///
/// # Panics
/// If the widths differ.
pub fn sine(x: Tensor<2>, bias: Tensor<1>, omega: f32) -> Tensor<2> {
    assert_eq!(x.dims()[1], bias.dims()[0], "sine: one bias per column");
    let inputs = SineTensors { x: x.into_dispatch(), bias: bias.into_dispatch() };
    Tensor::from_dispatch(Dispatch::sine_forward(inputs, omega))
}

impl<B: CpuBackend> SineOps for B {
    fn sine_forward(inputs: SineTensors<Self>, omega: f32) -> FloatTensor<Self> {
        let [x, bias] = inputs.as_array().map(B::values);
        let mut out = vec![0.0; x.len()];
        forward(&x, &bias, omega, &mut out);
        B::tensor(out, inputs.x.shape(), &inputs.x.device())
    }
}

impl<B: CpuBackend> SineBackwardOps for B {
    fn sine_backward(inputs: SineTensors<Self>, grad: FloatTensor<Self>, omega: f32) -> SineTensors<Self> {
        let [x, bias] = inputs.as_array().map(B::values);
        let (mut of_x, mut of_bias) = (vec![0.0; x.len()], vec![0.0; bias.len()]);
        backward(&x, &bias, omega, &B::values(&grad), &mut of_x, &mut of_bias);
        like::<B, _>(inputs.as_array(), [of_x, of_bias]).into()
    }
}

/// The GPU implementation, by operations of the backend: passes over memory are cheap there compared with the matrix
/// products around them.
#[cfg(feature = "cube")]
mod cube {
    use super::{SineBackwardOps, SineOps, SineTensors};
    use burn::backend::TensorMetadata;
    use burn::backend::ops::FloatTensorOps;
    use burn::backend::tensor::FloatTensor;
    use burn_cubecl::CubeBackend;

    fn argument(inputs: SineTensors<CubeBackend>, omega: f32) -> FloatTensor<CubeBackend> {
        let width = inputs.bias.shape()[0];
        let bias = CubeBackend::float_reshape(inputs.bias, [1, width].into());
        CubeBackend::float_mul_scalar(CubeBackend::float_add(inputs.x, bias), omega.into())
    }

    impl SineOps for CubeBackend {
        fn sine_forward(inputs: SineTensors<Self>, omega: f32) -> FloatTensor<Self> {
            Self::float_sin(argument(inputs, omega))
        }
    }

    impl SineBackwardOps for CubeBackend {
        fn sine_backward(inputs: SineTensors<Self>, grad: FloatTensor<Self>, omega: f32) -> SineTensors<Self> {
            let shape = inputs.bias.shape();
            let slope = Self::float_mul_scalar(Self::float_cos(argument(inputs, omega)), omega.into());
            let x = Self::float_mul(grad, slope);
            SineTensors { bias: Self::float_reshape(Self::float_sum_dim(x.clone(), 0), shape), x }
        }
    }
}

impl<B: SineOps + SineBackwardOps, C: CheckpointStrategy> SineOps for Autodiff<B, C> {
    fn sine_forward(inputs: SineTensors<Self>, omega: f32) -> FloatTensor<Self> {
        let (inputs, nodes) = inputs.into_parts();
        recorded::<B, C, _, _>(
            nodes,
            (inputs, omega),
            |(inputs, omega)| B::sine_forward(inputs, omega),
            |(inputs, omega), grad| B::sine_backward(inputs, grad, omega).into_array(),
        )
    }
}
