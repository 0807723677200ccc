//! The deformation network of D3DGS (Yang et al., "Deformable 3D Gaussians for high-fidelity monocular dynamic scene
//! reconstruction", CVPR 2024): a multi-layer perceptron on frequency encodings of position and time that outputs the
//! changes.

use super::Gaussians;
use super::decoder::linear;
use super::encoder::implicit::{Layer, encode_points, encode_time};
use super::size::{MAX_DEPTH, MAX_OCTAVES, layer};
use crate::config::types::D3dgsConfig;
use crate::rng::{Purpose, Rng};
use burn::module::{Module, Param};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor, TensorData};
use volseggs_kernels::splat::SplatInputs;

/// Output columns: changes of mean, rotation and scale.
const OUTPUTS: [usize; 3] = [3, 4, 3];
/// Their sum.
const OUTPUT_COLUMNS: usize = 10;
/// Lower bound on a standard deviation after the changes, scene units.
const MIN_SCALE: f32 = 1e-8;

/// The network of the authors' code: eight layers of 256 with ReLU, whose input is concatenated again with the output
/// of the fifth, and a linear layer for the changes of mean, rotation and scale. Colours and opacity are unchanged. No
/// gradient flows back to the positions.
///
/// Differences from that code: a rotation is normalised when it is drawn, after its change has been added, whereas the
/// published rasteriser uses it unnormalised; and the order of the encoded values, which affects nothing.
#[derive(Module, Debug)]
pub struct DeformationNetwork {
    /// The two layers of the time network; empty where the encoded time is used directly.
    pub time: Vec<Layer>,
    /// The hidden layers in their order.
    pub layers: Vec<Layer>,
    /// `[width, 10]`
    pub output: Layer,
    #[module(skip)]
    config: D3dgsConfig,
}

impl DeformationNetwork {
    /// A new network. Weights and biases start as in PyTorch, uniform in +-1 / sqrt(inputs). With `zero_outputs` the
    /// weights of the last layer start within 1e-4 of zero and its biases at zero: exactly zero weights would hold the
    /// gradients of all other layers at zero.
    pub fn new(config: &D3dgsConfig, seed: u64, device: &Device) -> Self {
        let mut rng = Rng::new(seed, 3, Purpose::EncoderInit);
        let mut values = |n: usize, bound: f32| (0..n).map(|_| bound * (2.0 * rng.uniform() - 1.0)).collect::<Vec<_>>();
        let mut layer = |inputs: usize, outputs: usize, bounds: [f32; 2]| {
            let weight = TensorData::new(values(inputs * outputs, bounds[0]), [inputs, outputs]);
            let bias = TensorData::new(values(outputs, bounds[1]), [outputs]);
            Layer {
                weight: Param::from_tensor(Tensor::from_data(weight, device)),
                bias: Param::from_tensor(Tensor::from_data(bias, device)),
            }
        };
        let mut plain = |inputs: usize, outputs: usize| layer(inputs, outputs, [(inputs as f32).powf(-0.5); 2]);
        let time = match config.time_features {
            0 => Vec::new(),
            features => vec![plain(waves(config.time_octaves), config.time_width), plain(config.time_width, features)],
        };
        let layers = (0..config.depth).map(|i| plain(inputs(config, i), config.width)).collect();
        let output = match config.zero_outputs {
            true => layer(config.width, OUTPUT_COLUMNS, [1e-4, 0.0]),
            false => plain(config.width, OUTPUT_COLUMNS),
        };
        Self { time, layers, output, config: config.clone() }
    }

    /// Changes `[N, 10]` of mean, rotation and scale at positions `[N, 3]` (scene units) and a time in [0, 1], or
    /// slightly beyond with noise.
    pub fn forward(&self, positions: Tensor<2>, time: f32) -> Tensor<2> {
        let [n, _] = positions.dims();
        let mut of_time = encode_time(time, self.config.time_octaves, &positions.device());
        for (i, layer) in self.time.iter().enumerate() {
            of_time = linear(if i > 0 { relu(of_time) } else { of_time }, &layer.weight, &layer.bias);
        }
        let points = encode_points(positions.detach(), self.config.octaves);
        let encoded = Tensor::cat(vec![points, of_time.repeat_dim(0, n)], 1);
        let mut x = encoded.clone();
        for (i, layer) in self.layers.iter().enumerate() {
            if i > 0 && i == self.config.skip {
                x = Tensor::cat(vec![encoded.clone(), x], 1);
            }
            x = relu(linear(x, &layer.weight, &layer.bias));
        }
        linear(x, &self.output.weight, &self.output.bias)
    }

    /// The Gaussians at a time: x + dx, q / |q| + dq, exp(s) + ds (a negative scale counts by its magnitude, as only
    /// its square is drawn).
    pub fn deform(&self, gaussians: &Gaussians, time: f32) -> SplatInputs {
        let means = gaussians.means.val();
        let change = self.forward(means.clone(), time);
        let [n, _] = change.dims();
        let [to_mean, to_rotation, _] = OUTPUTS;
        let columns = |from: usize, to: usize| change.clone().slice([0..n, from..to]);
        let rotations = gaussians.rotations.val();
        let length = rotations.clone().powi_scalar(2).sum_dim(1).clamp_min(1e-24).sqrt();
        let scales = gaussians.log_scales.val().exp() + columns(to_mean + to_rotation, OUTPUT_COLUMNS);
        SplatInputs {
            means: means + columns(0, to_mean),
            rotations: rotations / length + columns(to_mean, to_mean + to_rotation),
            log_scales: scales.powi_scalar(2).clamp_min(MIN_SCALE * MIN_SCALE).log().mul_scalar(0.5),
            ..gaussians.val()
        }
    }
}

/// Number of values that encode one number: itself and its octaves.
fn waves(octaves: usize) -> usize {
    1 + 2 * octaves
}

/// Number of inputs of the first layer.
fn encoded(config: &D3dgsConfig) -> usize {
    let time = if config.time_features > 0 { config.time_features } else { waves(config.time_octaves) };
    3 * waves(config.octaves) + time
}

/// Number of inputs of hidden layer `i`.
fn inputs(config: &D3dgsConfig, i: usize) -> usize {
    match i {
        0 => encoded(config),
        i if i == config.skip => encoded(config) + config.width,
        _ => config.width,
    }
}

/// Rejects sizes that no network can have, naming the key.
///
/// # Errors
/// The first such key with its value and the allowed range.
pub fn check(config: &D3dgsConfig) -> Result<(), String> {
    let D3dgsConfig { depth, skip, .. } = *config;
    // (key, value, min, max)
    let ranges = [
        ("octaves", config.octaves, 0, MAX_OCTAVES),
        ("time_octaves", config.time_octaves, 0, MAX_OCTAVES),
        ("time_features", config.time_features, 0, MAX_WIDTH),
        ("time_width", config.time_width, 1, MAX_WIDTH),
        ("width", config.width, 1, MAX_WIDTH),
        ("depth", depth, 1, MAX_DEPTH),
    ];
    for (name, value, min, max) in ranges {
        if !(min..=max).contains(&value) {
            return Err(format!("d3dgs.{name} = {value}: from {min} to {max}"));
        }
    }
    if skip >= depth {
        return Err(format!("d3dgs.skip = {skip}: below d3dgs.depth = {depth}, as a layer must follow it; 0 for none"));
    }
    Ok(())
}

/// Widest layer that could fit into memory.
const MAX_WIDTH: usize = 1 << 16;

/// Number of parameters of the network for a configuration accepted by [`check`].
pub fn parameters(config: &D3dgsConfig) -> u128 {
    let of_time = match config.time_features {
        0 => 0,
        features => {
            layer(waves(config.time_octaves) as u128, config.time_width as u128)
                + layer(config.time_width as u128, features as u128)
        }
    };
    let hidden = (0..config.depth).map(|i| layer(inputs(config, i) as u128, config.width as u128));
    of_time + hidden.sum::<u128>() + layer(config.width as u128, OUTPUT_COLUMNS as u128)
}

/// Number of values that a step keeps per Gaussian until the gradients are computed: the input, the concatenated input
/// of the skip layer, each hidden layer before and after its ReLU, and the changes.
pub fn kept_values(config: &D3dgsConfig) -> u128 {
    let joined = if config.skip > 0 { encoded(config) + config.width } else { 0 };
    (encoded(config) + joined + 2 * config.depth * config.width + OUTPUT_COLUMNS) as u128
}

/// Number of values per Gaussian in the widest tensor.
pub fn widest(config: &D3dgsConfig) -> u128 {
    (0..config.depth).map(|i| inputs(config, i).max(config.width)).max().unwrap_or_default() as u128
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::DeviceName;
    use crate::model::HostGaussians;
    use crate::model::params::{self, to_vec};

    fn device() -> Device {
        DeviceName::all()[0].open().unwrap()
    }

    fn small() -> D3dgsConfig {
        D3dgsConfig { octaves: 2, time_octaves: 1, width: 5, depth: 4, skip: 2, ..D3dgsConfig::default() }
    }

    fn values(network: &DeformationNetwork) -> usize {
        params::sizes(network).values().sum()
    }

    #[test]
    fn the_published_networks_have_the_parameters_of_the_published_code() {
        // counted by hand from its layers: h0 of 84 or 93, eight of 256 with h0 again before the sixth, ten outputs
        assert_eq!(parameters(&D3dgsConfig::default()), 506_378);
        let synthetic = D3dgsConfig { time_octaves: 6, time_features: 30, ..D3dgsConfig::default() };
        assert_eq!(parameters(&synthetic), 522_280);
        for config in [D3dgsConfig::default(), synthetic, small(), D3dgsConfig { skip: 0, time_features: 3, ..small() }]
        {
            check(&config).unwrap();
            assert_eq!(
                values(&DeformationNetwork::new(&config, 1, &device())) as u128,
                parameters(&config),
                "{config:?}"
            );
        }
    }

    const POINTS: [[f64; 3]; 3] = [[0.3, -0.7, 1.1], [-1.0, 0.9, 0.45], [0.8, -0.15, 2.0]];
    const TIME: f64 = 0.35;

    /// A layer in f64: `x W + b`.
    fn plain(layer: &Layer, x: &[f64], rectified: bool) -> Vec<f64> {
        let (weight, bias) = (to_vec(layer.weight.val()), to_vec(layer.bias.val()));
        let columns = bias.len();
        let sum = |o: usize| {
            let products = x.iter().enumerate().map(|(k, v)| v * f64::from(weight[k * columns + o]));
            f64::from(bias[o]) + products.sum::<f64>()
        };
        (0..columns).map(sum).map(|v| if rectified { v.max(0.0) } else { v }).collect()
    }

    fn waves_of(values: &[f64], octaves: usize) -> Vec<f64> {
        let angles: Vec<f64> = (0..octaves).flat_map(|k| values.iter().map(move |v| v * 2f64.powi(k as i32))).collect();
        let (sin, cos) = (angles.iter().map(|a| a.sin()), angles.iter().map(|a| a.cos()));
        values.iter().copied().chain(sin).chain(cos).collect()
    }

    fn the_changes_are_those_of_plain_loops(device: Device) {
        for config in [small(), D3dgsConfig { time_features: 3, time_width: 4, ..small() }] {
            let network = DeformationNetwork::new(&config, 4, &device);
            let points = POINTS.as_flattened().iter().map(|v| *v as f32).collect::<Vec<_>>();
            let points = Tensor::<2>::from_data(TensorData::new(points, [POINTS.len(), 3]), &device);
            let found = to_vec(network.forward(points, TIME as f32));
            let expected = POINTS.iter().flat_map(|point| {
                // sine and cosine of one octave of one number
                let mut time = waves_of(&[TIME], config.time_octaves);
                for (i, layer) in network.time.iter().enumerate() {
                    time = plain(layer, &time, i == 0);
                }
                let encoded: Vec<f64> = waves_of(point, config.octaves).into_iter().chain(time).collect();
                let mut x = encoded.clone();
                for (i, layer) in network.layers.iter().enumerate() {
                    let joined = if i == config.skip { encoded.iter().chain(&x).copied().collect() } else { x };
                    x = plain(layer, &joined, true);
                }
                plain(&network.output, &x, false)
            });
            for (a, b) in found.iter().zip(expected.collect::<Vec<_>>()) {
                assert!((f64::from(*a) - b).abs() < 1e-5, "{a} {b}");
            }
        }
    }

    volseggs_testing::on_every_device!(
        crate::device::open_to_test => the_changes_are_those_of_plain_loops,
    );

    #[test]
    fn changes_are_added_as_published_and_no_gradient_goes_back_through_the_positions() {
        let device = device().autodiff();
        let network = DeformationNetwork::new(&small(), 4, &device);
        let host = HostGaussians {
            means: POINTS.as_flattened().iter().map(|v| *v as f32).collect(),
            rotations: [2.0, 0.0, 0.0, 0.0, 0.0, 0.6, 0.8, 0.0, 1.0, 1.0, 1.0, 1.0].to_vec(),
            log_scales: vec![-3.0, -2.0, -9.0, -1.0, -4.0, -5.0, 0.0, -20.0, -2.0],
            opacity_logits: vec![0.5; 3],
            sh: vec![0.1; 9],
            sh_stride: 1,
            ..HostGaussians::default()
        };
        let gaussians = Gaussians::from_host(host.clone(), &device);
        let change = to_vec(network.forward(gaussians.means.val(), 0.4));
        let at = network.deform(&gaussians, 0.4);
        let [means, rotations, log_scales] =
            [at.means.clone(), at.rotations.clone(), at.log_scales.clone()].map(|t| to_vec(t.inner()));
        for i in 0..3 {
            let row = &change[10 * i..][..10];
            let length = host.rotations[4 * i..][..4].iter().map(|v| v * v).sum::<f32>().sqrt();
            for k in 0..3 {
                assert!((means[3 * i + k] - host.means[3 * i + k] - row[k]).abs() < 1e-6);
                let scale = host.log_scales[3 * i + k].exp() + row[7 + k];
                assert!((log_scales[3 * i + k].exp() - scale.abs()).abs() < 1e-5, "{scale}");
            }
            for k in 0..4 {
                assert!((rotations[4 * i + k] - host.rotations[4 * i + k] / length - row[3 + k]).abs() < 1e-6);
            }
        }
        assert_eq!(to_vec(at.opacity_logits.inner()), host.opacity_logits);
        let gradients = at.means.sum().backward();
        let of_means = gaussians.means.val().grad(&gradients).map(to_vec);
        assert_eq!(of_means, Some(vec![1.0; 9]), "a mean moves its changed mean by as much, and by nothing else");
        assert!(network.output.weight.val().grad(&gradients).is_some());
    }

    #[test]
    fn outputs_that_start_at_zero_leave_the_gaussians_where_they_are() {
        let network = DeformationNetwork::new(&D3dgsConfig { zero_outputs: true, ..small() }, 4, &device());
        let points = Tensor::<2>::from_floats([[0.5, -2.0, 1.0]], &device());
        let found = to_vec(network.forward(points, 0.7));
        assert!(found.iter().all(|v| v.abs() < 1e-3) && found.iter().any(|v| *v != 0.0), "{found:?}");
    }
}
