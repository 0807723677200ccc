//! The paper's explicit encoder.

use super::{Encoder, EncoderFactory};
use crate::config::types::{GridInit, ModelConfig, TimeCurve};
use crate::memory::product;
use crate::model::time_curve;
use crate::rng::{Purpose, Rng};
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use volseggs_kernels::field::{FieldShape, LevelShape, field};

/// The paper's explicit encoder: planes, lines and temporal vectors at several resolutions.
///
/// The three flat buffers are laid out as described in [`FieldShape`].
///
/// The paper's equation 4 sums over the ranks of space and of time,
/// `T4 = (sum_r Mxy_r o vz_r + Mxz_r o vy_r + Myz_r o vx_r) o (sum_r vt_r)`, which taken literally leaves one number a
/// level. Here, as in the released code, nothing is summed over r: each rank is a channel, and the decoder receives the
/// product of space and time for every channel of every level. [`volseggs_kernels::field`] explains why the sum is not
/// offered.
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
    #[module(skip)]
    curve: TimeCurve,
}

/// Makes [`FactorisedEncoder`]s.
pub(super) struct Factorised;

impl EncoderFactory for Factorised {
    fn create(&self, config: &ModelConfig, seed: u64, device: &Device) -> Encoder {
        Encoder::Factorised(FactorisedEncoder::new(config, seed, device))
    }

    fn parameters(&self, config: &ModelConfig) -> u128 {
        let [planes, lines] = grid_nodes(config);
        let over_time = lines.saturating_add(product(&[config.levels, config.time_knots]));
        planes.saturating_add(over_time).saturating_mul(config.channels as u128)
    }

    fn skips_culled(&self) -> bool {
        true
    }
}

/// Number of nodes of all planes, and of all lines, of every level; level m has `m * resolution` nodes per axis.
pub(super) fn grid_nodes(config: &ModelConfig) -> [u128; 2] {
    let (levels, nodes) = (config.levels as u128, config.resolution as u128);
    // sums of m and of m * m over the levels
    let next = levels.saturating_add(1);
    let sum = levels.saturating_mul(next) / 2;
    let squares = levels.saturating_mul(next).saturating_mul(levels.saturating_mul(2).saturating_add(1)) / 6;
    [squares.saturating_mul(nodes).saturating_mul(nodes), sum.saturating_mul(nodes)].map(|n| n.saturating_mul(3))
}

/// Sizes of the factorised encoder for a configuration: level m has `m * resolution` nodes per axis.
pub fn field_shape(config: &ModelConfig) -> FieldShape {
    FieldShape {
        levels: (1..=config.levels).map(|m| LevelShape { resolution: [m * config.resolution; 3] }).collect(),
        time_knots: config.time_knots,
        channels: config.channels,
    }
}

/// Initial values of planes and lines.
pub(super) fn first_values(init: GridInit, len: usize, rng: &mut Rng) -> Vec<f32> {
    match init {
        GridInit::Uniform => (0..len).map(|_| 0.1 + 0.4 * rng.uniform()).collect(),
        GridInit::Zero => vec![0.0; len],
    }
}

impl FactorisedEncoder {
    /// A new encoder.
    ///
    /// With all three factors at zero, every gradient of the data is zero too (a dead saddle), so the default
    /// initialises planes and lines in [0.1, 0.5] and temporal vectors at 1.
    pub fn new(config: &ModelConfig, seed: u64, device: &Device) -> Self {
        let shape = field_shape(config);
        let mut rng = Rng::new(seed, 0, Purpose::EncoderInit);
        let mut values = |len| first_values(config.grid_init, len, &mut rng);
        let (planes, lines) = (values(shape.planes_len()), values(shape.lines_len()));
        let time = if config.grid_init == GridInit::Uniform { 1.0 } else { 0.0 };
        let param = |v: Vec<f32>| {
            let n = v.len();
            Param::from_tensor(Tensor::from_data(TensorData::new(v, [n]), device))
        };
        Self {
            planes: param(planes),
            lines: param(lines),
            times: param(vec![time; shape.times_len()]),
            shape,
            curve: config.time_curve,
        }
    }

    /// Features `[N, levels * channels]` of points `[N, 3]` in [-1, 1] at `time` in [0, 1] over all knots.
    pub fn forward(&self, points: Tensor<2>, time: f32) -> Tensor<2> {
        let (planes, lines, times) = (self.planes.val(), self.lines.val(), self.times.val());
        match self.curve {
            TimeCurve::Linear => field(planes, lines, times, points, &self.shape, time),
            TimeCurve::Cubic => {
                let (levels, device) = (self.shape.levels.len(), points.device());
                let now = time_curve::cubic(times, levels, self.shape.time_knots, time, &device);
                // the vectors of this time alone
                let shape = FieldShape { time_knots: 1, ..self.shape.clone() };
                field(planes, lines, now, points, &shape, 0.0)
            }
        }
    }

    /// Sizes and layout.
    pub fn shape(&self) -> &FieldShape {
        &self.shape
    }
}
