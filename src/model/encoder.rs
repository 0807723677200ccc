//! Space-time encoders: a point and a time in, features out. Registered ones are in [`super::extra_encoder`].

use super::decoder::linear;
use super::extra_encoder::ExtraEncoder;
use crate::config::types::{GridInit, ModelConfig};
use crate::rng::{Purpose, Rng};
use burn::module::{Module, Param};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor, TensorData};
use volseggs_kernels::field::{FieldShape, LevelShape, field};

/// The paper's explicit encoder: planes, lines and temporal vectors at several resolutions.
///
/// The three flat buffers are laid out as [`FieldShape`] says.
#[derive(Module, Debug)]
pub struct FactorisedEncoder {
    /// Spatial feature matrices of all levels, flat.
    pub planes: Param<Tensor<1>>,
    /// Spatial feature vectors of all levels, flat.
    pub lines: Param<Tensor<1>>,
    /// Temporal feature vectors of all levels, flat.
    pub times: Param<Tensor<1>>,
    #[module(skip)]
    shape: FieldShape,
}

/// Sizes of the factorised encoder for a configuration: level m has `m * resolution` nodes an axis.
pub fn field_shape(config: &ModelConfig) -> FieldShape {
    FieldShape {
        levels: (1..=config.levels).map(|m| LevelShape { resolution: [m * config.resolution; 3] }).collect(),
        time_knots: config.time_knots,
        channels: config.channels,
    }
}

impl FactorisedEncoder {
    /// A new encoder.
    ///
    /// Started at zero in all three factors every gradient of the data is zero too (a dead saddle), so
    /// the default starts planes and lines in [0.1, 0.5] and temporal vectors at 1.
    pub fn new(config: &ModelConfig, seed: u64, device: &Device) -> Self {
        let shape = field_shape(config);
        let mut rng = Rng::new(seed, 0, Purpose::EncoderInit as u64);
        let mut values = |len: usize| -> Vec<f32> {
            match config.grid_init {
                GridInit::Uniform => (0..len).map(|_| 0.1 + 0.4 * rng.uniform()).collect(),
                GridInit::Zero => vec![0.0; len],
            }
        };
        let (planes, lines) = (values(shape.planes_len()), values(shape.lines_len()));
        let time = if config.grid_init == GridInit::Uniform { 1.0 } else { 0.0 };
        let param = |v: Vec<f32>| {
            let n = v.len();
            Param::from_tensor(Tensor::from_data(TensorData::new(v, [n]), device))
        };
        Self { planes: param(planes), lines: param(lines), times: param(vec![time; shape.times_len()]), shape }
    }

    /// Features `[N, levels * channels]` of points `[N, 3]` in [-1, 1] at `time` in [0, 1] over all knots.
    pub fn forward(&self, points: Tensor<2>, time: f32) -> Tensor<2> {
        field(self.planes.val(), self.lines.val(), self.times.val(), points, &self.shape, time)
    }

    /// Sizes and layout.
    pub fn shape(&self) -> &FieldShape {
        &self.shape
    }
}

/// The fully implicit encoder of the paper's ablation: positional encoding of the point, the time, two
/// hidden layers.
#[derive(Module, Debug)]
pub struct ImplicitEncoder {
    /// `[6 * octaves + 1, width]`
    pub first_weight: Param<Tensor<2>>,
    /// `[width]`
    pub first_bias: Param<Tensor<1>>,
    /// `[width, width]`
    pub second_weight: Param<Tensor<2>>,
    /// `[width]`
    pub second_bias: Param<Tensor<1>>,
    /// `[width, features]`
    pub last_weight: Param<Tensor<2>>,
    /// `[features]`
    pub last_bias: Param<Tensor<1>>,
    octaves: usize,
}

impl ImplicitEncoder {
    /// A new encoder with as many features as the factorised one would have.
    pub fn new(config: &ModelConfig, seed: u64, device: &Device) -> Self {
        let mut rng = Rng::new(seed, 1, Purpose::EncoderInit as u64);
        let features = config.levels * config.channels;
        let inputs = 6 * config.implicit_octaves + 1;
        let width = config.width;
        let mut layer = |i, o| super::decoder::xavier(&mut rng, i, o, device);
        let bias = |n: usize| Param::from_tensor(Tensor::zeros([n], device));
        Self {
            first_weight: layer(inputs, width),
            first_bias: bias(width),
            second_weight: layer(width, width),
            second_bias: bias(width),
            last_weight: layer(width, features),
            last_bias: bias(features),
            octaves: config.implicit_octaves,
        }
    }

    /// Features `[N, levels * channels]` of points `[N, 3]` in [-1, 1] at `time` in [0, 1].
    pub fn forward(&self, points: Tensor<2>, time: f32) -> Tensor<2> {
        let [n, _] = points.dims();
        let device = points.device();
        let mut parts = Vec::with_capacity(2 * self.octaves + 1);
        for k in 0..self.octaves {
            let angle = points.clone().mul_scalar(std::f32::consts::PI * (1 << k) as f32);
            parts.push(angle.clone().sin());
            parts.push(angle.cos());
        }
        parts.push(Tensor::full([n, 1], time, &device));
        let x = Tensor::cat(parts, 1);
        let x = relu(linear(x, &self.first_weight, &self.first_bias));
        let x = relu(linear(x, &self.second_weight, &self.second_bias));
        linear(x, &self.last_weight, &self.last_bias)
    }
}

/// One of the encoders.
#[derive(Module, Debug)]
#[allow(clippy::large_enum_variant)] // one of them exists per scene
pub enum Encoder {
    /// Planes, lines and temporal vectors.
    Factorised(FactorisedEncoder),
    /// A multi-layer perceptron.
    Implicit(ImplicitEncoder),
    /// A registered one.
    Extra(ExtraEncoder),
}
