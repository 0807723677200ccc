//! The fully implicit encoder of the paper's ablation: a multi-layer perceptron on frequency encodings of point and
//! time.

use super::{Encoder, EncoderFactory};
use crate::config::types::ModelConfig;
use crate::model::decoder::linear;
use crate::model::size::{MAX_DEPTH, MAX_OCTAVES, layer};
use crate::rng::{Purpose, Rng};
use burn::module::{Module, Param};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor, TensorData};

/// Makes [`ImplicitEncoder`]s.
pub(super) struct Implicit;

impl EncoderFactory for Implicit {
    fn check(&self, config: &ModelConfig) -> Result<(), String> {
        let (depth, skip) = (config.implicit_depth, config.implicit_skip);
        // (key, value, min, max)
        let ranges = [
            ("octaves", config.implicit_octaves, 0, MAX_OCTAVES),
            ("time_octaves", config.implicit_time_octaves, 0, MAX_OCTAVES),
            ("width", config.implicit_width, 1, usize::MAX),
            ("depth", depth, 1, MAX_DEPTH),
        ];
        for (name, value, min, max) in ranges {
            if value < min {
                return Err(format!("model.implicit_{name} = {value}: at least {min}"));
            }
            if value > max {
                return Err(format!("model.implicit_{name} = {value}: at most {max}"));
            }
        }
        if skip >= depth {
            return Err(format!(
                "model.implicit_skip = {skip}: below model.implicit_depth = {depth}, as a layer must follow it; 0 for none"
            ));
        }
        Ok(())
    }

    fn create(&self, config: &ModelConfig, seed: u64, device: &Device) -> Encoder {
        Encoder::Implicit(ImplicitEncoder::new(config, seed, device))
    }

    fn parameters(&self, config: &ModelConfig) -> u128 {
        let (depth, skip) = (config.implicit_depth as u128, config.implicit_skip as u128);
        let (width, inputs, outputs) = (config.implicit_width as u128, encoded(config), self.features(config));
        if depth < 2 {
            return layer(inputs, outputs);
        }
        let within = (depth - 2).saturating_mul(layer(width, width));
        let whole = layer(inputs, width).saturating_add(within).saturating_add(layer(width, outputs));
        let joins = if skip == depth - 1 { outputs } else { width };
        whole.saturating_add(if skip > 0 { inputs.saturating_mul(joins) } else { 0 })
    }

    /// Its input, the concatenated input of the skip layer, and each layer but the last before and after its ReLU.
    fn kept_values(&self, config: &ModelConfig) -> u128 {
        let (width, inputs) = (config.implicit_width as u128, encoded(config));
        let joined = if config.implicit_skip > 0 { inputs.saturating_add(width) } else { 0 };
        let layers = (config.implicit_depth as u128).saturating_sub(1).saturating_mul(width);
        inputs.saturating_add(joined).saturating_add(layers.saturating_mul(2))
    }

    fn widest_layer(&self, config: &ModelConfig) -> u128 {
        let (inputs, width) = (encoded(config), config.implicit_width as u128);
        if config.implicit_skip > 0 { inputs.saturating_add(width) } else { inputs.max(width) }
    }

    fn products(&self, config: &ModelConfig) -> f64 {
        self.parameters(config) as f64
    }
}

/// Number of values that encode a point and a time.
fn encoded(config: &ModelConfig) -> u128 {
    let waves = |octaves: usize| (octaves as u128).saturating_mul(2).saturating_add(1);
    waves(config.implicit_octaves).saturating_mul(3).saturating_add(waves(config.implicit_time_octaves))
}

/// A layer: `x W + b`.
#[derive(Module, Debug)]
pub struct Layer {
    /// `[inputs, outputs]`
    pub weight: Param<Tensor<2>>,
    /// `[outputs]`
    pub bias: Param<Tensor<1>>,
}

/// A multi-layer perceptron in place of planes, lines and temporal vectors.
///
/// The paper does not describe the network of its ablation, so this is the deformation network of D3DGS (Yang et al.,
/// CVPR 2024, which the paper follows), as in its authors' code: eight layers, 256 wide, with ReLU between them; the
/// encoded input is concatenated again with the output of the fifth. A value v is encoded as v, sin(2^k v) and
/// cos(2^k v), without a factor of pi: 10 octaves for the point, 6 for time. No gradient flows back to the points.
///
/// Differences from D3DGS:
///
/// - The eighth layer outputs the features, as many as those of the factorised encoder and likewise of either sign, so
///   that the decoder is the same behind both.
/// - Weights start as He et al. (2015) initialise layers before a ReLU, uniform within sqrt(6 / inputs) of zero, biases
///   at zero. PyTorch's default, which D3DGS keeps, is within 1 / sqrt(inputs): eight such layers initially shrink
///   differences between positions to a thousandth of those of their input, and learn more slowly (20.8 dB against 21.5
///   after 600 steps on `vortex` at 100x100, 3,000 Gaussians, one seed, with a ReLU after the eighth layer as well).
/// - Points are relative to the field's box, in [-1, 1], not in scene units. The encoding of time, in [0, 1], is used
///   directly, without the small network before it that D3DGS has for synthetic data.
///
/// The default has 450,368 parameters. The paper's sizes (37.36 MiB with the implicit network, 43.48 with the hybrid
/// one; 62 floats per Gaussian) leave it 382,000 to 472,000, for as many Gaussians as the hybrid model has and for
/// 150,000, the number beyond which none are added. With an eighth layer of 256 and one more to the decoder it would be
/// 516,160.
#[derive(Module, Debug)]
pub struct ImplicitEncoder {
    /// The layers in order.
    pub layers: Vec<Layer>,
    octaves: usize,
    time_octaves: usize,
    skip: usize,
}

impl ImplicitEncoder {
    /// A new encoder with as many features as the factorised one would have.
    pub fn new(config: &ModelConfig, seed: u64, device: &Device) -> Self {
        let mut rng = Rng::new(seed, 1, Purpose::EncoderInit);
        let (octaves, time_octaves) = (config.implicit_octaves, config.implicit_time_octaves);
        let (depth, skip) = (config.implicit_depth, config.implicit_skip);
        let encoded = 3 * (1 + 2 * octaves) + 1 + 2 * time_octaves;
        let width = |layer: usize| {
            if layer + 1 < depth { config.implicit_width } else { config.levels * config.channels }
        };
        let layer = |i: usize| {
            let again = if i > 0 && i == skip { encoded } else { 0 };
            let inputs = again + if i == 0 { encoded } else { width(i - 1) };
            let (bound, outputs) = ((6.0 / inputs as f32).sqrt(), width(i));
            let values: Vec<f32> = (0..inputs * outputs).map(|_| bound * (2.0 * rng.uniform() - 1.0)).collect();
            let weight = Tensor::from_data(TensorData::new(values, [inputs, outputs]), device);
            Layer { weight: Param::from_tensor(weight), bias: Param::from_tensor(Tensor::zeros([outputs], device)) }
        };
        Self { layers: (0..depth).map(layer).collect(), octaves, time_octaves, skip }
    }

    /// Features `[N, levels * channels]` of points `[N, 3]` in [-1, 1] at `time` in [0, 1].
    pub fn forward(&self, points: Tensor<2>, time: f32) -> Tensor<2> {
        // as in D3DGS: the highest octaves would jitter the means with slopes of several hundred
        let encoded = self.encode(points.detach(), time);
        let mut x = encoded.clone();
        for (i, layer) in self.layers.iter().enumerate() {
            if i > 0 && i == self.skip {
                x = Tensor::cat(vec![encoded.clone(), x], 1);
            }
            x = linear(x, &layer.weight, &layer.bias);
            if i + 1 < self.layers.len() {
                x = relu(x);
            }
        }
        x
    }

    /// `[N, 3 + 6 * octaves + 1 + 2 * time_octaves]`
    fn encode(&self, points: Tensor<2>, time: f32) -> Tensor<2> {
        let time = encode_time(time, self.time_octaves, &points.device()).repeat_dim(0, points.dims()[0]);
        Tensor::cat(vec![encode_points(points, self.octaves), time], 1)
    }
}

/// Points `[N, 3]` with sine and cosine of 2^k times them, k below `octaves`: `[N, 3 + 6 * octaves]`.
pub(in crate::model) fn encode_points(points: Tensor<2>, octaves: usize) -> Tensor<2> {
    if octaves == 0 {
        return points;
    }
    let angles = Tensor::cat((0..octaves).map(|k| points.clone().mul_scalar(octave(k))).collect(), 1);
    Tensor::cat(vec![points, angles.clone().sin(), angles.cos()], 1)
}

/// The same encoding of a time, `[1, 1 + 2 * octaves]`.
pub(in crate::model) fn encode_time(time: f32, octaves: usize, device: &Device) -> Tensor<2> {
    let angles = (0..octaves).map(|k| time * octave(k));
    let times: Vec<f32> = std::iter::once(time).chain(angles.flat_map(|a| [a.sin(), a.cos()])).collect();
    let row = [1, times.len()];
    Tensor::from_data(TensorData::new(times, row), device)
}

fn octave(k: usize) -> f32 {
    (1u32 << k) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::preset;
    use crate::device::{DeviceName, largest_buffer};
    use crate::model::size::{encoder_parameters, field_parameters};
    use crate::model::{params, params::HostTensor};
    use std::collections::BTreeMap;

    fn tiny() -> ModelConfig {
        let mut config = preset("best").unwrap().model;
        (config.encoder, config.levels, config.channels) = ("implicit".into(), 1, 2);
        (config.implicit_octaves, config.implicit_time_octaves, config.implicit_width) = (2, 1, 5);
        (config.implicit_depth, config.implicit_skip) = (4, 2);
        config
    }

    const POINTS: [[f64; 3]; 4] = [[0.3, -0.7, 0.1], [-1.0, 0.9, 0.45], [0.0, 0.2, -0.6], [0.8, -0.15, 1.0]];
    const TIME: f64 = 0.35;

    /// The features of [`POINTS`] in f64, from plain loops over the parameters.
    fn reference(parameters: &BTreeMap<String, (Vec<usize>, Vec<f64>)>, config: &ModelConfig) -> Vec<f64> {
        let waves = |values: &[f64], octaves: usize| -> Vec<f64> {
            let angles: Vec<f64> =
                (0..octaves).flat_map(|k| values.iter().map(move |v| v * 2f64.powi(k as i32))).collect();
            angles.iter().map(|a| a.sin()).chain(angles.iter().map(|a| a.cos())).collect()
        };
        let mut features = Vec::new();
        for point in POINTS {
            let mut encoded = point.to_vec();
            encoded.extend(waves(&point, config.implicit_octaves));
            encoded.push(TIME);
            let of_time = waves(&[TIME], config.implicit_time_octaves);
            let (sin, cos) = of_time.split_at(config.implicit_time_octaves);
            encoded.extend(sin.iter().zip(cos).flat_map(|(s, c)| [*s, *c]));
            let mut x = encoded.clone();
            for i in 0..config.implicit_depth {
                if i > 0 && i == config.implicit_skip {
                    x = encoded.iter().chain(&x).copied().collect();
                }
                let (shape, weight) = &parameters[&format!("layers.{i}.weight")];
                let (_, bias) = &parameters[&format!("layers.{i}.bias")];
                assert_eq!(shape[0], x.len());
                let sum = |o: usize| bias[o] + (0..shape[0]).map(|k| x[k] * weight[k * shape[1] + o]).sum::<f64>();
                let last = i + 1 == config.implicit_depth;
                x = (0..shape[1]).map(|o| if last { sum(o) } else { sum(o).max(0.0) }).collect();
            }
            features.extend(x);
        }
        features
    }

    #[test]
    fn features_and_every_gradient_are_those_of_plain_loops() {
        for name in DeviceName::all() {
            let device = name.open().unwrap().autodiff();
            let config = tiny();
            let encoder = ImplicitEncoder::new(&config, 4, &device);
            let host = params::collect(&encoder);
            let wide = |t: HostTensor| (t.shape, t.values.iter().map(|v| f64::from(*v)).collect::<Vec<f64>>());
            let mut parameters: BTreeMap<_, _> = host.into_iter().map(|(name, t)| (name, wide(t))).collect();
            let points = TensorData::new(POINTS.as_flattened().iter().map(|v| *v as f32).collect(), [POINTS.len(), 3]);
            let points = Tensor::<2>::from_data(points, &device).require_grad();
            let features = encoder.forward(points.clone(), TIME as f32);
            let expected = reference(&parameters, &config);
            let varied = |k: usize| expected.iter().skip(2).step_by(2).any(|v| (v - expected[k]).abs() > 1e-3);
            assert!(varied(0), "alive: {expected:?}");
            for (a, b) in params::to_vec(features.clone()).iter().zip(&expected) {
                assert!((f64::from(*a) - b).abs() < 1e-5, "{a} {b}");
            }

            let loss =
                |features: &[f64]| -> f64 { features.iter().enumerate().map(|(i, f)| f * (1.0 + i as f64)).sum() };
            let weights = TensorData::new((1..=8).map(|v| v as f32).collect(), [POINTS.len(), 2]);
            let gradients = (features * Tensor::<2>::from_data(weights, &device)).sum().backward();
            assert!(points.grad(&gradients).is_none(), "points are encoded as they are");
            let mut checked = 0;
            for (i, layer) in encoder.layers.iter().enumerate() {
                let found = [
                    ("weight", params::to_vec(layer.weight.val().grad(&gradients).unwrap())),
                    ("bias", params::to_vec(layer.bias.val().grad(&gradients).unwrap())),
                ];
                for (kind, gradient) in found {
                    let name = format!("layers.{i}.{kind}");
                    for (k, found) in gradient.iter().enumerate() {
                        let mut at = |step: f64| {
                            parameters.get_mut(&name).unwrap().1[k] += step;
                            let value = loss(&reference(&parameters, &config));
                            parameters.get_mut(&name).unwrap().1[k] -= step;
                            value
                        };
                        let expected = (at(1e-6) - at(-1e-6)) / 2e-6;
                        let tolerance = 1e-4 * expected.abs().max(1.0);
                        assert!((f64::from(*found) - expected).abs() < tolerance, "{name}[{k}]: {found} {expected}");
                        checked += 1;
                    }
                }
            }
            assert_eq!(checked as u128, encoder_parameters(&config));
        }
    }

    #[test]
    fn the_default_has_the_layers_of_d3dgs_and_the_size_that_the_paper_implies() {
        let device = DeviceName::all()[0].open().unwrap();
        let mut config = preset("best").unwrap().model;
        config.encoder = "implicit".into();
        let encoder = ImplicitEncoder::new(&config, 0, &device);
        let shapes: Vec<[usize; 2]> = encoder.layers.iter().map(|l| l.weight.dims()).collect();
        let (point, time) = (63, 13);
        let (first, again) = ([point + time, 256], [point + time + 256, 256]);
        let whole = [256, 256];
        assert_eq!(shapes, [first, whole, whole, whole, whole, again, whole, [256, 64]]);

        // the paper's table of network structures: MiB of a PLY of 62 floats per Gaussian and the network
        let floats = |mib: f64| mib * f64::from(1 << 20) / 4.0;
        let config = ModelConfig { embedding: 0, ..config };
        let decoder = (field_parameters(&config) - encoder_parameters(&config)) as f64;
        let paper = ModelConfig { encoder: "factorised".into(), ..config.clone() };
        let hybrid = field_parameters(&paper) as f64;
        let implied = |gaussians: f64| floats(37.36) - 62.0 * gaussians - decoder;
        let max_gaussians = (floats(43.48) - hybrid) / 62.0;
        let (low, high) = (implied(max_gaussians), implied(150_000.0));
        assert!(low > 0.38e6 && high < 0.473e6, "{low} {high}");
        let count = encoder_parameters(&config);
        assert_eq!(count, 450_368);
        assert!((low..high).contains(&(count as f64)) && (380_000..460_000).contains(&count), "{count}");
    }

    #[test]
    fn initial_features_distinguish_places_and_differ_by_seed() {
        let device = DeviceName::all()[0].open().unwrap();
        let config = ModelConfig { encoder: "implicit".into(), ..preset("best").unwrap().model };
        let encoder = |seed: u64| ImplicitEncoder::new(&config, seed, &device);
        let (one, other) = (params::collect(&encoder(1)), params::collect(&encoder(2)));
        assert_eq!(one, params::collect(&encoder(1)));
        for (name, tensor) in &one {
            let largest = tensor.values.iter().fold(0.0f32, |m, v| m.max(v.abs()));
            if name.ends_with("bias") {
                assert_eq!(largest, 0.0, "{name}");
                continue;
            }
            let bound = (6.0 / tensor.shape[0] as f32).sqrt();
            assert!(largest <= bound && largest > 0.99 * bound, "{name}: {largest} {bound}");
            assert_ne!(tensor, &other[name], "{name}");
        }
        let mut rng = Rng::new(1, 2, Purpose::Custom(3));
        let points: Vec<f32> = (0..3 * 200).map(|_| 2.0 * rng.uniform() - 1.0).collect();
        let points = Tensor::<2>::from_data(TensorData::new(points, [200, 3]), &device);
        let features = params::to_vec(encoder(1).forward(points, 0.5));
        for k in 0..64 {
            let column: Vec<f32> = features.iter().skip(k).step_by(64).copied().collect();
            let mean = column.iter().sum::<f32>() / 200.0;
            let spread = (column.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / 200.0).sqrt();
            assert!((0.1..3.0).contains(&spread), "feature {k}: {spread}");
        }
    }

    #[test]
    fn bits_do_not_depend_on_the_number_of_threads() {
        for name in DeviceName::all() {
            if largest_buffer(&name.open().unwrap()).is_some() {
                continue; // a GPU has threads of its own
            }
            let mut config = tiny();
            (config.implicit_width, config.channels) = (256, 64);
            let run = || {
                let device = name.open().unwrap().autodiff();
                let encoder = ImplicitEncoder::new(&config, 4, &device);
                let mut rng = Rng::new(1, 2, Purpose::Custom(3));
                let points = TensorData::new((0..3 * 500).map(|_| rng.uniform()).collect::<Vec<f32>>(), [500, 3]);
                let features = encoder.forward(Tensor::from_data(points, &device), 0.3);
                let gradients = (features.clone() * features.clone()).sum().backward();
                let of = |layer: &Layer| params::to_vec(layer.weight.val().grad(&gradients).unwrap());
                (params::to_vec(features), encoder.layers.iter().map(of).collect::<Vec<_>>())
            };
            let with =
                |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(run);
            assert!(with(1) == with(4), "{name:?}");
        }
    }

    #[test]
    fn octaves_and_skip_may_be_zero() {
        let device = DeviceName::all()[0].open().unwrap();
        let mut config = tiny();
        (config.implicit_octaves, config.implicit_time_octaves) = (0, 0);
        (config.implicit_depth, config.implicit_skip) = (1, 0);
        let encoder = ImplicitEncoder::new(&config, 4, &device);
        assert_eq!(encoder.layers[0].weight.dims(), [4, 2]);
        let features = encoder.forward(Tensor::<2>::zeros([3, 3], &device), 0.5);
        assert_eq!(features.dims(), [3, 2]);
    }
}
