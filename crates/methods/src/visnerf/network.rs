//! Grids and networks: density of positions, colour of positions seen from directions.

use super::grid::{BatchTimes, FactorisedGrid, GridSize};
use crate::layers::{layer, pytorch_bound, softplus};
use crate::visnerf::VisNerfConfig;
use burn::module::Module;
use burn::tensor::activation::sigmoid;
use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;
use volseggs_base::rng::{Purpose, Rng};
use volseggs_core::model::encoder::implicit::Layer;
use volseggs_kernels::decoder::{DecoderShape, DecoderWeights, decoder};

/// Two hidden layers with ReLU and an output layer without.
#[derive(Module, Debug)]
pub struct VisNerfMlp {
    first: Layer,
    second: Layer,
    output: Layer,
}

impl VisNerfMlp {
    /// Weights and biases are initialised as in PyTorch, except for the output's biases, which start at 0.
    fn new([inputs, width, outputs]: [usize; 3], rng: &mut Rng, device: &Device) -> Self {
        let bound = pytorch_bound;
        Self {
            first: layer(rng, [inputs, width], bound(inputs), bound(inputs), device),
            second: layer(rng, [width, width], bound(width), bound(width), device),
            output: layer(rng, [width, outputs], bound(width), 0.0, device),
        }
    }

    fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        let [inputs, width] = self.first.weight.dims();
        let [outputs] = self.output.bias.dims();
        let of = |layer: &Layer| (layer.weight.val(), layer.bias.val());
        let weights = DecoderWeights { trunk: of(&self.first), hidden: of(&self.second), output: of(&self.output) };
        decoder(x, None, weights, &DecoderShape { inputs, width, head_sizes: vec![outputs] })
    }
}

/// All trained parameters.
#[derive(Module, Debug)]
pub struct VisNerfNetwork {
    /// The grid of density.
    pub density: FactorisedGrid,
    /// The grid of appearance.
    pub appearance: FactorisedGrid,
    density_mlp: VisNerfMlp,
    colour_mlp: VisNerfMlp,
    octaves: usize,
    pub(super) density_shift: f64,
}

/// Inputs of a network: three values and some features, each unchanged and as sines and cosines.
fn inputs(config: &VisNerfConfig) -> usize {
    (3 + config.features) * (1 + 2 * config.octaves)
}

/// Sizes of the grids of density and of appearance.
pub fn grid_sizes(config: &VisNerfConfig, resolution: [usize; 3], knots: usize) -> [GridSize; 2] {
    let (time_ranks, features) = (config.time_ranks, config.features);
    [config.density_ranks, config.appearance_ranks].map(|ranks| GridSize {
        resolution,
        ranks,
        knots,
        time_ranks,
        features,
    })
}

/// Number of trained values; saturates.
pub fn parameters(config: &VisNerfConfig, resolution: [usize; 3], knots: usize) -> u128 {
    let (width, inputs) = (config.width as u128, inputs_wide(config));
    let mlp = |outputs: u128| {
        let layers = [(inputs, width), (width, width), (width, outputs)];
        let of = |(i, o): (u128, u128)| i.saturating_mul(o).saturating_add(o);
        layers.into_iter().map(of).fold(0, u128::saturating_add)
    };
    let grids = grid_sizes(config, resolution, knots).map(|size| size.parameters());
    [grids[0], grids[1], mlp(1), mlp(3)].into_iter().fold(0, u128::saturating_add)
}

/// [`inputs`] for any configuration, without overflow.
fn inputs_wide(config: &VisNerfConfig) -> u128 {
    (3 + config.features as u128).saturating_mul(1 + 2 * config.octaves as u128)
}

impl VisNerfNetwork {
    /// A network with random weights.
    pub fn new(config: &VisNerfConfig, resolution: [usize; 3], knots: usize, seed: u64, device: &Device) -> Self {
        let mut rng = Rng::new(seed, 0, Purpose::MethodInit);
        let [density, appearance] =
            grid_sizes(config, resolution, knots).map(|s| FactorisedGrid::new(&s, &mut rng, device));
        let mut mlp = |outputs: usize| VisNerfMlp::new([inputs(config), config.width, outputs], &mut rng, device);
        Self {
            density,
            appearance,
            density_mlp: mlp(1),
            colour_mlp: mlp(3),
            octaves: config.octaves,
            density_shift: config.density_shift,
        }
    }

    /// Densities `[N]`, at least 0, at positions `points` `[N, 3]` in [-1, 1].
    pub fn densities(&self, points: &[f32], times: &BatchTimes, device: &Device) -> Tensor<1> {
        let n = points.len() / 3;
        let places = Tensor::<2>::from_data(TensorData::new(points.to_vec(), [n, 3]), device);
        let features = self.density.forward(places, times);
        let out = self.density_mlp.forward(self.encoded(points, features, device));
        softplus(out.reshape([n]).sub_scalar(self.density_shift))
    }

    /// Colours `[N, 3]` in [0, 1] at positions `points` `[N, 3]`, seen along unit vectors `directions` `[N, 3]`.
    pub fn colours(&self, points: &[f32], directions: &[f32], times: &BatchTimes, device: &Device) -> Tensor<2> {
        let n = points.len() / 3;
        let places = Tensor::<2>::from_data(TensorData::new(points.to_vec(), [n, 3]), device);
        let features = self.appearance.forward(places, times);
        sigmoid(self.colour_mlp.forward(self.encoded(directions, features, device)))
    }

    /// Concatenates `vectors` `[N, 3]` and features, each unchanged and as sines and cosines of 1, 2, 4, ... times
    /// them. The order of the columns differs from the published one, which no result depends on.
    fn encoded(&self, vectors: &[f32], features: Tensor<2>, device: &Device) -> Tensor<2> {
        let columns = 3 * (1 + 2 * self.octaves);
        let mut fixed = vec![0.0; vectors.len() / 3 * columns];
        fixed.par_chunks_exact_mut(columns).zip(vectors.par_chunks_exact(3)).for_each(|(row, vector)| {
            row[..3].copy_from_slice(vector);
            for (k, pair) in row[3..].chunks_exact_mut(6).enumerate() {
                for c in 0..3 {
                    (pair[c], pair[3 + c]) = ((1u32 << k) as f32 * vector[c]).sin_cos();
                }
            }
        });
        let fixed = TensorData::new(fixed, [vectors.len() / 3, columns]);
        let mut parts = vec![Tensor::from_data(fixed, device), features.clone()];
        // each octave from the last by the double-angle formulas, so that one sine and one cosine are computed per
        // feature
        let (mut sine, mut cosine) = (features.clone().sin(), features.cos());
        for k in 0..self.octaves {
            if k > 0 {
                let twice = (sine.clone() * cosine).mul_scalar(2.0);
                cosine = sine.square().mul_scalar(-2.0).add_scalar(1.0);
                sine = twice;
            }
            parts.extend([sine.clone(), cosine.clone()]);
        }
        Tensor::cat(parts, 1)
    }
}

#[cfg(test)]
impl VisNerfNetwork {
    /// The same network with outputs that are always 0.
    pub(super) fn with_outputs_of_zero(mut self) -> Self {
        for mlp in [&mut self.density_mlp, &mut self.colour_mlp] {
            let weight = mlp.output.weight.val();
            mlp.output.weight = burn::module::Param::from_tensor(weight.zeros_like());
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{Reference, device};
    use crate::visnerf::grid::mixture;
    use volseggs_core::model::params::{self, to_vec};

    #[test]
    fn it_is_as_large_as_the_published_one() {
        // counted from the published code with a cubic box of 128^3 voxels and 30 training times: 12.38 MiB; the
        // VolSegGS paper's table has 12.32 and 12.39
        let config = VisNerfConfig::default();
        assert_eq!(inputs(&config), 150);
        assert_eq!(parameters(&config, [128; 3], 30), 3_244_684);
        let small = VisNerfConfig { density_ranks: 4, appearance_ranks: 6, features: 5, width: 8, ..config };
        let network = VisNerfNetwork::new(&small, [3, 4, 5], 7, 0, &device());
        let held: usize = params::sizes(&network).values().sum();
        assert_eq!(parameters(&small, [3, 4, 5], 7), held as u128);
    }

    #[test]
    fn onnx_runtime_gives_the_same_densities_and_colours() {
        let reference = Reference::read("visnerf");
        let config = VisNerfConfig {
            density_ranks: 2,
            appearance_ranks: 3,
            time_ranks: 2,
            features: 4,
            width: 6,
            density_shift: 0.5,
            ..VisNerfConfig::default()
        };
        let device = device();
        let network = params::load(VisNerfNetwork::new(&config, [3, 4, 5], 3, 0, &device), &reference.0).unwrap();
        let [points, directions] = ["points", "directions"].map(|name| to_vec(reference.input::<2>(name)));
        let times = BatchTimes::new(&[mixture(3, 0.375)], &[0; 9], &device);
        reference.check("densities", network.densities(&points, &times, &device));
        reference.check("colours", network.colours(&points, &directions, &times, &device));
    }

    #[test]
    fn what_networks_see_are_sines_of_doubled_angles() {
        let config = VisNerfConfig { octaves: 3, features: 2, ..VisNerfConfig::default() };
        let device = device();
        let network = VisNerfNetwork::new(&config, [2; 3], 1, 0, &device);
        let features = Tensor::<2>::from_floats([[0.7, -2.3]], &device);
        let row = to_vec(network.encoded(&[0.1, -0.4, 0.9], features, &device));
        let waves = |values: &[f64], k: i32| -> Vec<f64> {
            let angles: Vec<f64> = values.iter().map(|v| v * 2f64.powi(k)).collect();
            angles.iter().map(|a| a.sin()).chain(angles.iter().map(|a| a.cos())).collect()
        };
        let (vector, features) = ([0.1, -0.4, 0.9], [0.7, -2.3]);
        let mut expected = vector.to_vec();
        expected.extend((0..3).flat_map(|k| waves(&vector, k)));
        expected.extend(features);
        expected.extend((0..3).flat_map(|k| waves(&features, k)));
        assert_eq!(row.len(), inputs(&config));
        for (k, (found, expected)) in row.iter().zip(&expected).enumerate() {
            assert!((f64::from(*found) - expected).abs() < 1e-5, "{k}: {found} for {expected}");
        }
    }

    #[test]
    fn densities_start_at_almost_nothing_and_colours_in_the_middle() {
        let device = device();
        let config = VisNerfConfig { width: 16, ..VisNerfConfig::default() };
        let network = VisNerfNetwork::new(&config, [4; 3], 2, 0, &device);
        let times = BatchTimes::new(&[mixture(2, 0.5)], &[0, 0], &device);
        let points = [0.1, 0.2, 0.3, -0.9, 0.0, 1.0];
        assert!(to_vec(network.densities(&points, &times, &device)).iter().all(|v| *v > 1e-5 && *v < 3e-4));
        let colours = to_vec(network.colours(&points, &[0.0, 0.6, 0.8, 1.0, 0.0, 0.0], &times, &device));
        assert!(colours.iter().all(|v| *v > 0.2 && *v < 0.8), "{colours:?}");
    }
}
