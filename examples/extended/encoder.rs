//! An encoder without a grid: waves in space and time whose directions, frequencies, phases and heights are learnt.

use std::f32::consts::TAU;
use volseggs::burn::tensor::Tensor;
use volseggs::config::types::ModelConfig;
use volseggs::extend::{EncoderDefinition, EncoderParameter, Parameters};
use volseggs::rng::Rng;

/// One feature is `height * sin(frequency . [x, y, z, t] + phase)`.
pub struct Waves {
    /// Standard deviation of the initial frequencies, in radians over half the box (and over all of time).
    pub frequency: f32,
}

impl EncoderDefinition for Waves {
    fn features(&self, config: &ModelConfig) -> usize {
        config.levels * config.channels // as many as in the factorised encoder
    }

    fn parameters(&self, config: &ModelConfig, rng: &mut Rng) -> Vec<EncoderParameter> {
        let waves = self.features(config);
        vec![
            EncoderParameter::from_fn("frequencies", [4, waves], || self.frequency * rng.normal()),
            EncoderParameter::from_fn("phases", [1, waves], || TAU * rng.uniform()),
            EncoderParameter::from_fn("heights", [1, waves], || 1.0),
        ]
    }

    fn forward(&self, parameters: &Parameters, points: Tensor<2>, time: f32) -> Tensor<2> {
        let times = Tensor::full([points.dims()[0], 1], time, &points.device());
        let angles = Tensor::cat(vec![points, times], 1).matmul(parameters.get::<2>("frequencies"));
        (angles + parameters.get::<2>("phases")).sin() * parameters.get::<2>("heights")
    }
}
