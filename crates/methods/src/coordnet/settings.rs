//! `coordnet.*`

use crate::ranges::{above_zero, at_least_one, not_negative};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use volseggs_core::config::sections::Settings;

/// `coordnet.*`: network and training of CoordNet. The defaults are the published settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CoordNetConfig {
    /// Widths of the first residual blocks, one block each; the last is also the width of the blocks that follow.
    pub widths: Vec<usize>,
    /// Number of further residual blocks, all of the last width.
    pub blocks: usize,
    /// Frequency factor inside each sine.
    pub omega: f64,
    /// Number of steps. The published training has 300 epochs of 128,000 pixels of each view: 1,200 steps per training
    /// view.
    pub steps: usize,
    /// Pixels of each view in an epoch, redrawn every epoch; at most the pixels of the view.
    pub pixels_per_view: usize,
    /// Pixels per step.
    pub batch: usize,
    /// Learning rate of Adam.
    pub rate: f64,
    /// Weight in the loss of half the sum of all squared weights and biases.
    pub weight_decay: f64,
}

impl Settings for CoordNetConfig {
    const SECTION: &'static str = "coordnet";
}

impl Default for CoordNetConfig {
    fn default() -> Self {
        Self {
            widths: vec![64, 128, 256],
            blocks: 10,
            omega: 30.0,
            steps: 720_000,
            pixels_per_view: 128_000,
            batch: 32_000,
            rate: 1e-5,
            weight_decay: 1e-6,
        }
    }
}

impl CoordNetConfig {
    /// Rejects settings that no training can start with.
    ///
    /// # Errors
    /// The first invalid key with its value, and the values allowed.
    pub fn check(&self) -> Result<(), String> {
        if self.widths.is_empty() || self.widths.contains(&0) {
            return Err(format!("coordnet.widths = {:?}: at least one width, each at least 1", self.widths));
        }
        if self.blocks > 1000 {
            return Err(format!("coordnet.blocks = {}: at most 1000", self.blocks));
        }
        at_least_one(&[
            ("coordnet.steps", self.steps),
            ("coordnet.pixels_per_view", self.pixels_per_view),
            ("coordnet.batch", self.batch),
        ])?;
        above_zero(&[("coordnet.omega", self.omega), ("coordnet.rate", self.rate)])?;
        not_negative(&[("coordnet.weight_decay", self.weight_decay)])
    }
}
