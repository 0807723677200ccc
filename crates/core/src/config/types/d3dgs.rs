//! `d3dgs.*`

use crate::config::sections::Settings;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `d3dgs.*`: deformation network of D3DGS and its noise on time; the Gaussians are set in the other sections. The
/// defaults are the published settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct D3dgsConfig {
    /// Octaves of the encoding of a position p as p, sin(2^k p) and cos(2^k p), k from 0; scene units.
    pub octaves: usize,
    /// Octaves of the encoding of time.
    pub time_octaves: usize,
    /// Features that a small network computes from the encoded time (`is_blender` of the published code); 0 uses the
    /// encoded time itself.
    pub time_features: usize,
    /// Width of that network's hidden layer.
    pub time_width: usize,
    /// Width of the hidden layers.
    pub width: usize,
    /// Number of hidden layers, without the outputs.
    pub depth: usize,
    /// Number of hidden layers after which the input is concatenated again; 0 for never.
    pub skip: usize,
    /// Initialise the outputs to zero, so that joint training begins where warm-up ended; the published code does not.
    pub zero_outputs: bool,
    /// Standard deviation of the noise on time at the first step, in intervals between training times; 0 for none.
    pub time_noise: f64,
    /// Steps of the whole training over which this noise decays linearly to zero.
    pub time_noise_steps: usize,
}

impl Settings for D3dgsConfig {
    const SECTION: &'static str = "d3dgs";
}

impl Default for D3dgsConfig {
    fn default() -> Self {
        Self {
            octaves: 10,
            time_octaves: 10,
            time_features: 0,
            time_width: 256,
            width: 256,
            depth: 8,
            skip: 5,
            zero_outputs: false,
            time_noise: 0.1,
            time_noise_steps: 20_000,
        }
    }
}
