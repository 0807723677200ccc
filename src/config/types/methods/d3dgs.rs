//! `d3dgs.*`

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `d3dgs.*`: the deformation network of D3DGS, and its noise on time; the Gaussians are those of the other sections.
/// The defaults are the published ones.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct D3dgsConfig {
    /// Octaves of a position p, which goes in as p, sin(2^k p) and cos(2^k p), k from 0; world units.
    pub octaves: usize,
    /// Octaves of time.
    pub time_octaves: usize,
    /// Features that a small network makes of encoded time (`is_blender` of the published code); 0 for encoded time itself.
    pub time_features: usize,
    /// Width of that network's hidden layer.
    pub time_width: usize,
    /// Width of the hidden layers.
    pub width: usize,
    /// How many there are, without the outputs.
    pub depth: usize,
    /// After so many of them the input goes in again; 0 for never.
    pub skip: usize,
    /// Start the outputs at zero, so that joint training begins where warm-up ended; the published code does not.
    pub zero_outputs: bool,
    /// Standard deviation of the noise on time at the first step, in intervals between training times; 0 for none.
    pub time_noise: f64,
    /// Steps of the whole training over which it falls to zero, linearly.
    pub time_noise_steps: usize,
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
