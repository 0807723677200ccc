//! The decoder as a differentiable op on tensors for every backend, with its implementation for those in host memory.

use super::cpu::{backward, forward};
use super::params::{DecoderGrads, DecoderInputs, DecoderParams};
use super::shape::DecoderShape;
use crate::backend::{CpuBackend, zeros};
use crate::tensors::{like, op_tensors, recorded};
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, TensorMetadata, backend_extension};
use burn::tensor::Tensor;

op_tensors! {
    /// The inputs of [`decoder`] on a backend, or the gradient with respect to each of them.
    DecoderTensors[8] {
        /// `[N, inputs - E]`
        features,
        /// `[N, E]`; E may be 0.
        own,
        /// `[inputs, width]`
        w0,
        /// `[width]`
        b0,
        /// `[width, heads * width]`
        w1,
        /// `[heads * width]`
        b1,
        /// `[width, outputs]`
        w2,
        /// `[outputs]`
        b2,
    }
}

/// The backend side of [`decoder`].
#[backend_extension(Autodiff, NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"), LibTorch: cfg(feature = "tch"))]
pub trait DecoderOps: Backend {
    /// Returns the outputs `[N, outputs]`.
    fn decoder_forward(#[extension_type] inputs: DecoderTensors<Self>, shape: DecoderShape) -> FloatTensor<Self>;
}

/// The backward side of [`decoder`], for backends that compute. The autodiff backend does not implement it, so a second
/// derivative does not compile.
pub trait DecoderBackwardOps: Backend {
    /// Returns the gradients for `grad` `[N, outputs]`.
    fn decoder_backward(
        inputs: DecoderTensors<Self>,
        grad: FloatTensor<Self>,
        shape: DecoderShape,
    ) -> DecoderTensors<Self>;
}

/// The decoder's weights as tensors; shapes as in [`DecoderTensors`].
#[derive(Clone, Debug)]
pub struct DecoderWeights {
    /// Trunk `[inputs, width]` and `[width]`.
    pub trunk: (Tensor<2>, Tensor<1>),
    /// Hidden layers of all heads, concatenated: `[width, heads * width]` and `[heads * width]`.
    pub hidden: (Tensor<2>, Tensor<1>),
    /// Outputs `[width, outputs]` and `[outputs]`.
    pub output: (Tensor<2>, Tensor<1>),
}

/// Applies a trunk and its heads, fused, to features `[N, inputs - E]` with `own` `[N, E]` beside them, if given; returns
/// `[N, outputs]`. Differentiable with respect to all inputs.
///
/// # Panics
/// If `shape` is invalid, or a tensor does not fit it.
pub fn decoder(
    features: Tensor<2>,
    own: Option<Tensor<2>>,
    weights: DecoderWeights,
    shape: &DecoderShape,
) -> Tensor<2> {
    if let Err(error) = shape.validate() {
        panic!("{error}");
    }
    let DecoderWeights { trunk, hidden, output } = weights;
    let (inputs, width, all, outputs) = (shape.inputs, shape.width, shape.heads() * shape.width, shape.outputs());
    let n = features.dims()[0];
    let own = own.unwrap_or_else(|| Tensor::zeros([n, 0], &features.device()));
    let beside = own.dims()[1];
    assert!(beside <= inputs, "decoder: {beside} numbers of a row's own, {inputs} inputs");
    let matrices = [
        ("features", &features, [n, inputs - beside]),
        ("own", &own, [n, beside]),
        ("trunk", &trunk.0, [inputs, width]),
        ("hidden", &hidden.0, [width, all]),
        ("output", &output.0, [width, outputs]),
    ];
    for (name, tensor, dims) in matrices {
        assert_eq!(tensor.dims(), dims, "decoder: {name}");
    }
    for (name, bias, length) in [("trunk", &trunk.1, width), ("hidden", &hidden.1, all), ("output", &output.1, outputs)]
    {
        assert_eq!(bias.dims(), [length], "decoder: bias of {name}");
    }
    let inputs = DecoderTensors {
        features: features.into_dispatch(),
        own: own.into_dispatch(),
        w0: trunk.0.into_dispatch(),
        b0: trunk.1.into_dispatch(),
        w1: hidden.0.into_dispatch(),
        b1: hidden.1.into_dispatch(),
        w2: output.0.into_dispatch(),
        b2: output.1.into_dispatch(),
    };
    Tensor::from_dispatch(Dispatch::decoder_forward(inputs, shape.clone()))
}

impl<B: CpuBackend> DecoderOps for B {
    fn decoder_forward(inputs: DecoderTensors<Self>, shape: DecoderShape) -> FloatTensor<Self> {
        let n = inputs.features.shape()[0];
        let [features, own, w0, b0, w1, b1, w2, b2] = inputs.as_array().map(B::values);
        let params = DecoderParams { w0: &w0, b0: &b0, w1: &w1, b1: &b1, w2: &w2, b2: &b2 };
        let mut out = zeros(n * shape.outputs());
        forward(&shape, params, DecoderInputs { features: &features, own: &own }, &mut out);
        B::tensor(out, [n, shape.outputs()], &inputs.features.device())
    }
}

impl<B: CpuBackend> DecoderBackwardOps for B {
    fn decoder_backward(
        inputs: DecoderTensors<Self>,
        grad: FloatTensor<Self>,
        shape: DecoderShape,
    ) -> DecoderTensors<Self> {
        let mut grads = inputs.as_array().map(|t| zeros(t.shape().num_elements()));
        let [features, own, w0, b0, w1, b1, w2, b2] = inputs.as_array().map(B::values);
        let params = DecoderParams { w0: &w0, b0: &b0, w1: &w1, b1: &b1, w2: &w2, b2: &b2 };
        let [gx, gown, g0, h0, g1, h1, g2, h2] = &mut grads;
        let out = DecoderGrads { w0: g0, b0: h0, w1: g1, b1: h1, w2: g2, b2: h2, features: gx, own: gown };
        let x = DecoderInputs { features: &features, own: &own };
        backward(&shape, params, x, &B::values(&grad), None, out);
        like::<B, _>(inputs.as_array(), grads).into()
    }
}

impl<B: DecoderOps + DecoderBackwardOps, C: CheckpointStrategy> DecoderOps for Autodiff<B, C> {
    fn decoder_forward(inputs: DecoderTensors<Self>, shape: DecoderShape) -> FloatTensor<Self> {
        let (inputs, nodes) = inputs.into_parts();
        recorded::<B, C, _, _>(
            nodes,
            (inputs, shape),
            |(inputs, shape)| B::decoder_forward(inputs, shape),
            |(inputs, shape), grad| B::decoder_backward(inputs, grad, shape).into_array(),
        )
    }
}
