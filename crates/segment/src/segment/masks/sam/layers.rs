//! Layers shared by all parts, built from their weights. The structure of the networks is elsewhere.

use super::SamError;
use super::weights::Scope;
use burn::module::{Module, Param};
use burn::tensor::Tensor;
use burn::tensor::activation::relu;
use burn::tensor::module::{conv_transpose2d, conv2d, layer_norm, linear};
use burn::tensor::ops::{ConvOptions, ConvTransposeOptions};

/// Batch and layer norms of PyTorch divide by the root of the variance plus this.
pub(super) const NORM_EPSILON: f64 = 1e-5;
/// The same for the layer norms over the channels of an image.
pub(super) const CHANNEL_NORM_EPSILON: f64 = 1e-6;

/// `x W + b` over the last axis.
#[derive(Module, Debug)]
pub(super) struct Linear {
    /// `[inputs, outputs]`; the file has the transpose.
    weight: Param<Tensor<2>>,
    bias: Param<Tensor<1>>,
}

impl Linear {
    pub(super) fn load(scope: &Scope<'_>, inputs: usize, outputs: usize) -> Result<Self, SamError> {
        let rows = scope.values("weight", &[outputs, inputs])?;
        let mut columns = Vec::with_capacity(rows.len());
        for i in 0..inputs {
            columns.extend((0..outputs).map(|o| rows[o * inputs + i]));
        }
        Ok(Self { weight: scope.place(columns, [inputs, outputs]), bias: scope.param("bias", [outputs])? })
    }

    pub(super) fn forward<const D: usize>(&self, x: Tensor<D>) -> Tensor<D> {
        linear(x, self.weight.val(), Some(self.bias.val()))
    }
}

/// Linear layers with ReLU between them.
#[derive(Module, Debug)]
pub(super) struct SamMlp {
    layers: Vec<Linear>,
}

impl SamMlp {
    /// Loads the layers `layers.0` to `layers.{depth - 1}`.
    pub(super) fn load(
        scope: &Scope<'_>,
        inputs: usize,
        hidden: usize,
        outputs: usize,
        depth: usize,
    ) -> Result<Self, SamError> {
        let layer = |i: usize| {
            let from = if i == 0 { inputs } else { hidden };
            let to = if i + 1 == depth { outputs } else { hidden };
            Linear::load(&scope.at("layers").at(i), from, to)
        };
        Ok(Self { layers: (0..depth).map(layer).collect::<Result<_, _>>()? })
    }

    pub(super) fn forward<const D: usize>(&self, x: Tensor<D>) -> Tensor<D> {
        let mut x = x;
        for (i, layer) in self.layers.iter().enumerate() {
            x = layer.forward(if i == 0 { x } else { relu(x) });
        }
        x
    }
}

/// Layer norm, over the last axis or over the channels of `[B, C, H, W]`.
#[derive(Module, Debug)]
pub(super) struct LayerNorm {
    weight: Param<Tensor<1>>,
    bias: Param<Tensor<1>>,
    epsilon: f64,
}

impl LayerNorm {
    pub(super) fn load(scope: &Scope<'_>, channels: usize, epsilon: f64) -> Result<Self, SamError> {
        Ok(Self { weight: scope.param("weight", [channels])?, bias: scope.param("bias", [channels])?, epsilon })
    }

    pub(super) fn forward<const D: usize>(&self, x: Tensor<D>) -> Tensor<D> {
        layer_norm(x, self.weight.val(), Some(self.bias.val()), self.epsilon)
    }

    /// Over the channels of `[B, C, H, W]`.
    pub(super) fn forward_channels(&self, x: Tensor<4>) -> Tensor<4> {
        self.forward(x.permute([0, 2, 3, 1])).permute([0, 3, 1, 2])
    }
}

/// The shape of a convolution with square kernels and padding that keeps the size at stride 1.
#[derive(Debug, Clone, Copy)]
pub(super) struct ConvShape {
    pub inputs: usize,
    pub outputs: usize,
    pub kernel: usize,
    pub stride: usize,
    /// One filter per channel instead of all to all.
    pub depthwise: bool,
}

impl ConvShape {
    pub(super) fn dense(inputs: usize, outputs: usize, kernel: usize, stride: usize) -> Self {
        Self { inputs, outputs, kernel, stride, depthwise: false }
    }

    pub(super) fn depthwise(channels: usize, kernel: usize, stride: usize) -> Self {
        Self { inputs: channels, outputs: channels, kernel, stride, depthwise: true }
    }

    fn weight(&self) -> [usize; 4] {
        [self.outputs, if self.depthwise { 1 } else { self.inputs }, self.kernel, self.kernel]
    }
}

/// A convolution of `[B, C, H, W]`.
#[derive(Module, Debug)]
pub(super) struct SamConv {
    weight: Param<Tensor<4>>,
    bias: Option<Param<Tensor<1>>>,
    stride: usize,
    groups: usize,
}

impl SamConv {
    fn new(shape: ConvShape, weight: Param<Tensor<4>>, bias: Option<Param<Tensor<1>>>) -> Self {
        let groups = if shape.depthwise { shape.inputs } else { 1 };
        Self { weight, bias, stride: shape.stride, groups }
    }

    /// A convolution without bias.
    pub(super) fn load(scope: &Scope<'_>, shape: ConvShape) -> Result<Self, SamError> {
        Ok(Self::new(shape, scope.param("weight", shape.weight())?, None))
    }

    /// A convolution `c` and the batch norm `bn` after it, with its running statistics, as one convolution.
    pub(super) fn load_folded(scope: &Scope<'_>, shape: ConvShape) -> Result<Self, SamError> {
        let mut weight = scope.at("c").values("weight", &shape.weight())?;
        let norm = scope.at("bn");
        let values = |name: &str| norm.values(name, &[shape.outputs]);
        let (gain, shift) = (values("weight")?, values("bias")?);
        let (mean, variance) = (values("running_mean")?, values("running_var")?);
        if variance.iter().any(|&v| v < 0.0) {
            return Err(norm.not_allowed("running_var"));
        }
        let filter = weight.len() / shape.outputs;
        let mut bias = Vec::with_capacity(shape.outputs);
        for (o, weights) in weight.chunks_exact_mut(filter).enumerate() {
            let scale = f64::from(gain[o]) / (f64::from(variance[o]) + NORM_EPSILON).sqrt();
            weights.iter_mut().for_each(|w| *w = (f64::from(*w) * scale) as f32);
            bias.push((f64::from(shift[o]) - f64::from(mean[o]) * scale) as f32);
        }
        let weight = scope.place(weight, shape.weight());
        Ok(Self::new(shape, weight, Some(scope.place(bias, [shape.outputs]))))
    }

    pub(super) fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let padding = self.weight.dims()[2] / 2;
        let options = ConvOptions::new([self.stride; 2], [padding; 2], [1, 1], self.groups);
        conv2d(x, self.weight.val(), self.bias.as_ref().map(Param::val), options)
    }
}

/// A transposed convolution that doubles height and width: kernel 2, stride 2.
#[derive(Module, Debug)]
pub(super) struct Doubling {
    /// `[inputs, outputs, 2, 2]`
    weight: Param<Tensor<4>>,
    bias: Param<Tensor<1>>,
}

impl Doubling {
    pub(super) fn load(scope: &Scope<'_>, inputs: usize, outputs: usize) -> Result<Self, SamError> {
        Ok(Self { weight: scope.param("weight", [inputs, outputs, 2, 2])?, bias: scope.param("bias", [outputs])? })
    }

    pub(super) fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let options = ConvTransposeOptions::new([2, 2], [0, 0], [0, 0], [1, 1], 1);
        conv_transpose2d(x, self.weight.val(), Some(self.bias.val()), options)
    }
}
