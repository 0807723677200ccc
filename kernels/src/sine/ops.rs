//! Sines as a differentiable op on tensors, for every backend.

use super::cpu::{backward, forward};
use crate::backend::{CpuBackend, for_cpu_backends};
use crate::tensors::{op_tensors, register};
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
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

fn cpu_forward<B: CpuBackend>(inputs: &SineTensors<B>, omega: f32) -> FloatTensor<B> {
    let [x, bias] = inputs.as_array().map(B::values);
    let mut out = vec![0.0; x.len()];
    forward(&x, &bias, omega, &mut out);
    B::tensor(out, inputs.x.shape(), &inputs.x.device())
}

fn cpu_backward<B: CpuBackend>(inputs: &SineTensors<B>, grad: &FloatTensor<B>, omega: f32) -> SineTensors<B> {
    let device = inputs.x.device();
    let [x, bias] = inputs.as_array().map(B::values);
    let (mut of_x, mut of_bias) = (vec![0.0; x.len()], vec![0.0; bias.len()]);
    backward(&x, &bias, omega, &B::values(grad), &mut of_x, &mut of_bias);
    SineTensors {
        x: B::tensor(of_x, inputs.x.shape(), &device),
        bias: B::tensor(of_bias, inputs.bias.shape(), &device),
    }
}

macro_rules! bind {
    ($backend:ty) => {
        impl SineOps for $backend {
            fn sine_forward(inputs: SineTensors<Self>, omega: f32) -> FloatTensor<Self> {
                cpu_forward::<Self>(&inputs, omega)
            }
        }

        impl SineBackwardOps for $backend {
            fn sine_backward(inputs: SineTensors<Self>, grad: FloatTensor<Self>, omega: f32) -> SineTensors<Self> {
                cpu_backward::<Self>(&inputs, &grad, omega)
            }
        }
    };
}

for_cpu_backends!(bind);

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

#[derive(Clone, Debug)]
struct State<B: SineBackwardOps> {
    inputs: SineTensors<B>,
    omega: f32,
}

#[derive(Debug)]
struct SineBackward;

impl<B: SineBackwardOps> Backward<B, 2> for SineBackward {
    type State = State<B>;

    fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _checkpointer: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let State { inputs, omega } = ops.state;
        let out = B::sine_backward(inputs, grad, omega);
        register::<B, 2>(grads, ops.parents.map(|p| p.map(|node| node.id)), out.into_array());
    }
}

impl<B: SineOps + SineBackwardOps, C: CheckpointStrategy> SineOps for Autodiff<B, C> {
    fn sine_forward(inputs: SineTensors<Self>, omega: f32) -> FloatTensor<Self> {
        let (inputs, nodes) = inputs.into_parts();
        let out = B::sine_forward(inputs.clone(), omega);
        match SineBackward.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(State { inputs, omega }, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }
}
