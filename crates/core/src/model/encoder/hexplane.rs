//! Planes of space and planes of space and time: the decomposition of HexPlane (Cao and Johnson, CVPR 2023).
//!
//! The paper's encoder multiplies a product over space by a vector over time, so that everything a channel holds rises
//! and falls together: in time it is of rank 1. Here the three lines change over time, which makes each a plane of one
//! axis and time, and a channel's feature is the sum over the axes of a spatial plane times the plane of the remaining
//! axis and time:
//!
//! `f(x, y, z, t) = Mxy(x, y) Vz(z, t) + Mxz(x, z) Vy(y, t) + Myz(y, z) Vx(x, t)`
//!
//! At one time the planes over time are lines, so points are looked up by the same op as in the paper's encoder.

use super::factorised::{field_shape, first_values, grid_nodes};
use super::{Encoder, EncoderFactory};
use crate::config::types::{ModelConfig, TimeCurve};
use crate::model::time_curve;
use crate::rng::{Purpose, Rng};
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use volseggs_kernels::field::{FieldShape, field};

/// Makes [`HexPlaneEncoder`]s.
pub(super) struct HexPlane;

impl EncoderFactory for HexPlane {
    fn create(&self, config: &ModelConfig, seed: u64, device: &Device) -> Encoder {
        Encoder::HexPlane(HexPlaneEncoder::new(config, seed, device))
    }

    fn parameters(&self, config: &ModelConfig) -> u128 {
        let [planes, lines] = grid_nodes(config);
        let over_time = lines.saturating_mul(config.time_knots as u128);
        planes.saturating_add(over_time).saturating_mul(config.channels as u128)
    }

    fn skips_culled(&self) -> bool {
        true
    }
}

/// The encoder.
#[derive(Module, Debug)]
pub struct HexPlaneEncoder {
    /// Spatial planes of all levels, flat as in [`FieldShape`].
    pub planes: Param<Tensor<1>>,
    /// Planes of an axis and time: for each time knot, the lines of all levels, flat as in [`FieldShape`],
    /// `[T, lines]`.
    pub lines: Param<Tensor<2>>,
    #[module(skip)]
    now: FieldShape,
    #[module(skip)]
    curve: TimeCurve,
}

impl HexPlaneEncoder {
    /// A new encoder: planes and lines uniform in [0.1, 0.5], the same at all times, or zero if `model.grid_init` says
    /// so.
    pub fn new(config: &ModelConfig, seed: u64, device: &Device) -> Self {
        // a single knot: what varies over time is in the lines
        let now = FieldShape { time_knots: 1, ..field_shape(config) };
        let mut rng = Rng::new(seed, 0, Purpose::EncoderInit);
        let mut values = |len| first_values(config.grid_init, len, &mut rng);
        let (planes, lines) = (values(now.planes_len()), values(now.lines_len()));
        let (n, knots) = (lines.len(), config.time_knots);
        let planes = Tensor::from_data(TensorData::new(planes, [now.planes_len()]), device);
        let lines = Tensor::from_data(TensorData::new(lines.repeat(knots), [knots, n]), device);
        Self { planes: Param::from_tensor(planes), lines: Param::from_tensor(lines), now, curve: config.time_curve }
    }

    /// Features `[N, levels * channels]` of points `[N, 3]` in [-1, 1] at `time` in [0, 1] over all knots.
    pub fn forward(&self, points: Tensor<2>, time: f32) -> Tensor<2> {
        let [knots, _] = self.lines.dims();
        let device = points.device();
        let weights = time_curve::weights(self.curve, knots, time);
        let weights = Tensor::<2>::from_data(TensorData::new(weights, [1, knots]), &device);
        let lines = weights.matmul(self.lines.val());
        field(self.planes.val(), lines.flatten(0, 1), self.ones(&device), points, &self.now, 0.0)
    }

    /// Replaces the temporal vectors of one time `[levels * channels]`.
    pub fn ones(&self, device: &Device) -> Tensor<1> {
        Tensor::ones([self.now.times_len()], device)
    }

    /// The lines of all levels, averaged over the knots, flat.
    pub fn mean_lines(&self) -> Tensor<1> {
        self.lines.val().mean_dim(0).flatten(0, 1)
    }

    /// Sizes and layout at one time.
    pub fn shape(&self) -> &FieldShape {
        &self.now
    }
}

#[cfg(test)]
mod tests {
    use super::super::factorised::FactorisedEncoder;
    use super::*;
    use crate::config::preset;
    use crate::config::types::GridInit;
    use crate::model::params::to_vec;

    fn config(curve: TimeCurve) -> ModelConfig {
        let mut config = preset("best").unwrap().model;
        (config.resolution, config.channels, config.time_knots, config.time_curve) = (4, 3, 5, curve);
        config
    }

    fn points(device: &Device) -> Tensor<2> {
        let values: Vec<f32> = (0..21).map(|i| (1.3 * i as f32).sin()).collect();
        Tensor::from_data(TensorData::new(values, [7, 3]), device)
    }

    /// An encoder whose planes over time differ between the knots.
    fn varied(curve: TimeCurve, device: &Device) -> HexPlaneEncoder {
        let mut encoder = HexPlaneEncoder::new(&config(curve), 3, device);
        let [knots, n] = encoder.lines.dims();
        let first = to_vec(encoder.lines.val());
        let lines = first.iter().enumerate().map(|(i, v)| v + 0.2 * (0.7 * i as f32).cos()).collect();
        encoder.lines = Param::from_tensor(Tensor::from_data(TensorData::new(lines, [knots, n]), device));
        encoder
    }

    #[test]
    fn it_starts_as_the_factorised_encoder_does_and_the_same_at_all_times() {
        let device = crate::device::DeviceName::all()[0].open().unwrap();
        let hexplane = HexPlaneEncoder::new(&config(TimeCurve::Linear), 3, &device);
        let factorised = FactorisedEncoder::new(&config(TimeCurve::Linear), 3, &device);
        let expected = to_vec(factorised.forward(points(&device), 0.0));
        for time in [0.0, 0.3, 1.0] {
            let found = to_vec(hexplane.forward(points(&device), time));
            assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-5), "{time}");
        }
        let zero = ModelConfig { grid_init: GridInit::Zero, ..config(TimeCurve::Linear) };
        assert!(to_vec(HexPlaneEncoder::new(&zero, 3, &device).lines.val()).iter().all(|v| *v == 0.0));
    }

    /// Compares features and the gradient of the lines `[T, lines]` with the op on lines interpolated here, with
    /// weights that have their own test.
    fn features_and_gradients_are_those_of_the_lines_of_a_time(device: Device) {
        let device = device.autodiff();
        for curve in [TimeCurve::Linear, TimeCurve::Cubic] {
            let encoder = varied(curve, &device);
            let [knots, n] = encoder.lines.dims();
            let time = 0.43;
            let out = encoder.forward(points(&device), time);
            let gradients = (out.clone() * out.clone()).sum().backward();
            let found = to_vec(encoder.lines.val().grad(&gradients).unwrap());

            let (all, weights) = (to_vec(encoder.lines.val()), time_curve::weights(curve, knots, time));
            let now: Vec<f32> = (0..n).map(|i| (0..knots).map(|k| weights[k] * all[k * n + i]).sum()).collect();
            let now = Tensor::<1>::from_data(TensorData::new(now, [n]), &device).require_grad();
            let ones = encoder.ones(&device);
            let wanted = field(encoder.planes.val(), now.clone(), ones, points(&device), encoder.shape(), 0.0);
            let gradients = (wanted.clone() * wanted.clone()).sum().backward();
            let of_now = to_vec(now.grad(&gradients).unwrap());
            let near = |a: f32, b: f32| (a - b).abs() < 1e-5 * b.abs().max(1.0);
            assert!(to_vec(out).into_iter().zip(to_vec(wanted)).all(|(a, b)| near(a, b)), "{curve:?}");
            for (i, value) in found.into_iter().enumerate() {
                assert!(near(value, weights[i / n] * of_now[i % n]), "{curve:?}, entry {i}");
            }
        }
    }

    volseggs_testing::on_every_device!(
        crate::device::open_to_test => features_and_gradients_are_those_of_the_lines_of_a_time,
    );
}
