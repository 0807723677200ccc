//! The decoder as a differentiable op on tensors, for every backend in host memory.

use super::cpu::{backward, forward};
use super::params::{DecoderGrads, DecoderParams};
use super::shape::DecoderShape;
use crate::backend::CpuBackend;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, ExtensionType, TensorMetadata, backend_extension};
use burn::tensor::Tensor;

/// Gradients of every input of [`decoder`].
#[derive(ExtensionType)]
pub struct DecoderGradients<B: Backend> {
    /// `[N, inputs]`
    pub x: FloatTensor<B>,
    /// `[inputs, width]`
    pub w0: FloatTensor<B>,
    /// `[width]`
    pub b0: FloatTensor<B>,
    /// `[width, heads * width]`
    pub w1: FloatTensor<B>,
    /// `[heads * width]`
    pub b1: FloatTensor<B>,
    /// `[width, outputs]`
    pub w2: FloatTensor<B>,
    /// `[outputs]`
    pub b2: FloatTensor<B>,
}

/// The backend side of [`decoder`].
#[backend_extension(Autodiff, NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"), LibTorch: cfg(feature = "tch"))]
pub trait DecoderOps: Backend {
    /// `[N, outputs]` for `x` `[N, inputs]`.
    fn decoder_forward(
        x: FloatTensor<Self>,
        w0: FloatTensor<Self>,
        b0: FloatTensor<Self>,
        w1: FloatTensor<Self>,
        b1: FloatTensor<Self>,
        w2: FloatTensor<Self>,
        b2: FloatTensor<Self>,
        shape: DecoderShape,
    ) -> FloatTensor<Self>;
}

/// The backward side of [`decoder`], of backends that compute. One that records gradients has none of its own: a second
/// derivative does not compile.
pub trait DecoderBackwardOps: Backend {
    /// Gradients for `grad` `[N, outputs]`.
    fn decoder_backward(
        x: FloatTensor<Self>,
        w0: FloatTensor<Self>,
        b0: FloatTensor<Self>,
        w1: FloatTensor<Self>,
        b1: FloatTensor<Self>,
        w2: FloatTensor<Self>,
        b2: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        shape: DecoderShape,
    ) -> DecoderGradients<Self>;
}

/// The decoder's weights as tensors; shapes as in [`DecoderGradients`].
#[derive(Clone, Debug)]
pub struct DecoderWeights {
    /// Trunk `[inputs, width]` and `[width]`.
    pub trunk: (Tensor<2>, Tensor<1>),
    /// Hidden layers of all heads side by side, `[width, heads * width]` and `[heads * width]`.
    pub hidden: (Tensor<2>, Tensor<1>),
    /// Outputs `[width, outputs]` and `[outputs]`.
    pub output: (Tensor<2>, Tensor<1>),
}

/// A trunk and its heads, fused: `[N, inputs]` to `[N, outputs]`, differentiable with respect to all.
///
/// # Panics
/// If a tensor does not fit `shape`.
pub fn decoder(x: Tensor<2>, weights: DecoderWeights, shape: &DecoderShape) -> Tensor<2> {
    let DecoderWeights { trunk, hidden, output } = weights;
    Tensor::from_dispatch(Dispatch::decoder_forward(
        x.into_dispatch(),
        trunk.0.into_dispatch(),
        trunk.1.into_dispatch(),
        hidden.0.into_dispatch(),
        hidden.1.into_dispatch(),
        output.0.into_dispatch(),
        output.1.into_dispatch(),
        shape.clone(),
    ))
}

fn cpu_forward<B: CpuBackend>(inputs: &[FloatTensor<B>; 7], shape: &DecoderShape) -> FloatTensor<B> {
    let n = inputs[0].shape()[0];
    let [x, w0, b0, w1, b1, w2, b2] = inputs.each_ref().map(|t| B::values(t));
    let params = DecoderParams { w0: &w0, b0: &b0, w1: &w1, b1: &b1, w2: &w2, b2: &b2 };
    let mut out = vec![0.0; n * shape.outputs()];
    forward(shape, params, &x, &mut out);
    B::tensor(out, [n, shape.outputs()], &inputs[0].device())
}

fn cpu_backward<B: CpuBackend>(
    inputs: &[FloatTensor<B>; 7],
    grad: &FloatTensor<B>,
    shape: &DecoderShape,
) -> DecoderGradients<B> {
    let device = inputs[0].device();
    let mut grads = inputs.each_ref().map(|t| vec![0.0f32; t.shape().num_elements()]);
    {
        let [x, w0, b0, w1, b1, w2, b2] = inputs.each_ref().map(|t| B::values(t));
        let params = DecoderParams { w0: &w0, b0: &b0, w1: &w1, b1: &b1, w2: &w2, b2: &b2 };
        let [gx, g0, h0, g1, h1, g2, h2] = &mut grads;
        let out = DecoderGrads { w0: g0, b0: h0, w1: g1, b1: h1, w2: g2, b2: h2, x: gx };
        backward(shape, params, &x, &B::values(grad), None, out);
    }
    let mut k = 0;
    let [x, w0, b0, w1, b1, w2, b2] = grads.map(|values| {
        k += 1;
        B::tensor(values, inputs[k - 1].shape(), &device)
    });
    DecoderGradients { x, w0, b0, w1, b1, w2, b2 }
}

macro_rules! bind {
    ($backend:ty) => {
        impl DecoderOps for $backend {
            fn decoder_forward(
                x: FloatTensor<Self>,
                w0: FloatTensor<Self>,
                b0: FloatTensor<Self>,
                w1: FloatTensor<Self>,
                b1: FloatTensor<Self>,
                w2: FloatTensor<Self>,
                b2: FloatTensor<Self>,
                shape: DecoderShape,
            ) -> FloatTensor<Self> {
                cpu_forward::<Self>(&[x, w0, b0, w1, b1, w2, b2], &shape)
            }
        }

        impl DecoderBackwardOps for $backend {
            fn decoder_backward(
                x: FloatTensor<Self>,
                w0: FloatTensor<Self>,
                b0: FloatTensor<Self>,
                w1: FloatTensor<Self>,
                b1: FloatTensor<Self>,
                w2: FloatTensor<Self>,
                b2: FloatTensor<Self>,
                grad: FloatTensor<Self>,
                shape: DecoderShape,
            ) -> DecoderGradients<Self> {
                cpu_backward::<Self>(&[x, w0, b0, w1, b1, w2, b2], &grad, &shape)
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
struct State<B: DecoderBackwardOps> {
    inputs: [FloatTensor<B>; 7],
    shape: DecoderShape,
}

#[derive(Debug)]
struct DecoderBackward;

impl<B: DecoderBackwardOps> Backward<B, 7> for DecoderBackward {
    type State = State<B>;

    fn backward(self, ops: Ops<Self::State, 7>, grads: &mut Gradients, _checkpointer: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let [x, w0, b0, w1, b1, w2, b2] = ops.state.inputs;
        let g = B::decoder_backward(x, w0, b0, w1, b1, w2, b2, grad, ops.state.shape);
        for (parent, grad) in ops.parents.into_iter().zip([g.x, g.w0, g.b0, g.w1, g.b1, g.w2, g.b2]) {
            if let Some(node) = parent {
                grads.register::<B>(node.id, grad);
            }
        }
    }
}

impl<B: DecoderOps + DecoderBackwardOps, C: CheckpointStrategy> DecoderOps for Autodiff<B, C> {
    fn decoder_forward(
        x: FloatTensor<Self>,
        w0: FloatTensor<Self>,
        b0: FloatTensor<Self>,
        w1: FloatTensor<Self>,
        b1: FloatTensor<Self>,
        w2: FloatTensor<Self>,
        b2: FloatTensor<Self>,
        shape: DecoderShape,
    ) -> FloatTensor<Self> {
        let (x, n0) = x.into_parts();
        let (w0, n1) = w0.into_parts();
        let (b0, n2) = b0.into_parts();
        let (w1, n3) = w1.into_parts();
        let (b1, n4) = b1.into_parts();
        let (w2, n5) = w2.into_parts();
        let (b2, n6) = b2.into_parts();
        let inputs = [x, w0, b0, w1, b1, w2, b2];
        let [x, w0, b0, w1, b1, w2, b2] = inputs.clone();
        let out = B::decoder_forward(x, w0, b0, w1, b1, w2, b2, shape.clone());
        match DecoderBackward.prepare::<C>([n0, n1, n2, n3, n4, n5, n6]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(State { inputs, shape }, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }
}
