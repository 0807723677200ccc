//! The affinity field: maps a position and a mask scale to a feature (the paper's figure 4c).

use crate::model::decoder::xavier;
use crate::model::params::to_vec;
use crate::rng::{Purpose, Rng};
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;
pub use volseggs_kernels::contrast::FEATURES;
use volseggs_kernels::decoder::{DecoderShape, DecoderWeights, decoder};

/// Octaves of the positional encoding: `sin` and `cos` of `2^k pi x` for each axis.
const OCTAVES: usize = 4;
/// Length of an encoded position.
pub const ENCODED: usize = 3 * 2 * OCTAVES;
/// Width of the hidden layers.
const WIDTH: usize = 64;

/// A small multi-layer perceptron, `25 -> 64 -> 64 -> 16`.
#[derive(Module, Debug)]
pub struct AffinityField {
    /// `[25, 64]`: encoded position and scale.
    pub first_weight: Param<Tensor<2>>,
    /// `[64]`
    pub first_bias: Param<Tensor<1>>,
    /// `[64, 64]`
    pub second_weight: Param<Tensor<2>>,
    /// `[64]`
    pub second_bias: Param<Tensor<1>>,
    /// `[64, 16]`
    pub output_weight: Param<Tensor<2>>,
    /// `[16]`
    pub output_bias: Param<Tensor<1>>,
}

/// The box that positions are measured in: its longest side becomes 1 and its centre 0, so that no two positions in it
/// have the same encoding.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PositionBox {
    /// Centre, scene units.
    pub centre: [f32; 3],
    /// Longest side, scene units.
    pub side: f32,
}

impl PositionBox {
    /// The box around the finite rows of `means` `[N, 3]`.
    pub fn around(means: &[f32]) -> Self {
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for p in means.chunks_exact(3).filter(|p| p.iter().all(|v| v.is_finite())) {
            for k in 0..3 {
                (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k]));
            }
        }
        if low[0] > high[0] {
            return Self { centre: [0.0; 3], side: 1.0 };
        }
        let side = (0..3).map(|k| high[k] - low[k]).fold(0.0, f32::max);
        Self { centre: [0, 1, 2].map(|k| 0.5 * (low[k] + high[k])), side: side.max(1e-6) }
    }

    /// Encodes `means` `[N, 3]` as `[N, 24]`.
    pub fn encode(&self, means: &[f32]) -> Vec<f32> {
        let mut out = vec![0.0; means.len() / 3 * ENCODED];
        out.par_chunks_exact_mut(ENCODED).zip(means.par_chunks_exact(3)).for_each(|(row, p)| {
            for (n, pair) in row.chunks_exact_mut(2).enumerate() {
                let (k, octave) = (n / OCTAVES, n % OCTAVES);
                let x = (p[k] - self.centre[k]) / self.side;
                let (sin, cos) = (std::f32::consts::PI * (1 << octave) as f32 * x).sin_cos();
                pair.copy_from_slice(&[sin, cos]);
            }
        });
        out
    }
}

impl AffinityField {
    /// Creates a field with random weights.
    pub fn new(seed: u64, device: &Device) -> Self {
        let mut rng = Rng::new(seed, 0, Purpose::AffinityInit);
        let bias = |n: usize| Param::from_tensor(Tensor::zeros([n], device));
        Self {
            first_weight: xavier(&mut rng, ENCODED + 1, WIDTH, device),
            first_bias: bias(WIDTH),
            second_weight: xavier(&mut rng, WIDTH, WIDTH, device),
            second_bias: bias(WIDTH),
            output_weight: xavier(&mut rng, WIDTH, FEATURES, device),
            output_bias: bias(FEATURES),
        }
    }

    /// Returns the features `[N, 16]` of encoded positions `[N, 24]` at `scale` in [0, 1]; not normalised.
    pub fn forward(&self, encoded: &[f32], scale: f32) -> Tensor<2> {
        self.forward_each(encoded, &vec![scale; encoded.len() / ENCODED])
    }

    /// Does the same with one scale per position, `[N]`.
    ///
    /// # Panics
    /// If the numbers of scales and positions differ.
    pub fn forward_each(&self, encoded: &[f32], scales: &[f32]) -> Tensor<2> {
        assert_eq!(encoded.len(), ENCODED * scales.len(), "scales: [N]");
        let device = self.first_weight.val().device();
        let n = encoded.len() / ENCODED;
        let mut inputs = Vec::with_capacity(n * (ENCODED + 1));
        for (row, scale) in encoded.chunks_exact(ENCODED).zip(scales) {
            inputs.extend_from_slice(row);
            inputs.push(*scale);
        }
        let weights = DecoderWeights {
            trunk: (self.first_weight.val(), self.first_bias.val()),
            hidden: (self.second_weight.val(), self.second_bias.val()),
            output: (self.output_weight.val(), self.output_bias.val()),
        };
        let shape = DecoderShape { inputs: ENCODED + 1, width: WIDTH, head_sizes: vec![FEATURES] };
        decoder(Tensor::from_data(TensorData::new(inputs, [n, ENCODED + 1]), &device), None, weights, &shape)
    }

    /// Returns unit features `[N, 16]` on the host.
    pub fn features(&self, encoded: &[f32], scale: f32) -> Vec<f32> {
        let mut out = to_vec(self.forward(encoded, scale));
        out.par_chunks_exact_mut(FEATURES).for_each(|row| {
            let norm = row.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-12);
            row.iter_mut().for_each(|v| *v /= norm);
        });
        out
    }
}
