//! `coordnet.*`

use super::{above_zero, at_least_one, not_negative};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `coordnet.*`: the network and the training of CoordNet. The defaults are the published settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CoordNetConfig {
    /// Widths of the first residual blocks, one block each; the last is the width of those behind them.
    pub widths: Vec<usize>,
    /// Residual blocks of that width behind them.
    pub blocks: usize,
    /// Factor inside each sine.
    pub omega: f64,
    /// Steps. Published are 300 epochs of 128,000 pixels of each view: 1,200 steps for each training view.
    pub steps: usize,
    /// Pixels of each view in an epoch, drawn anew each time; at most as many as it has.
    pub pixels_per_view: usize,
    /// Pixels a step.
    pub batch: usize,
    /// Learning rate of Adam.
    pub rate: f64,
    /// Weight of half the sum of all squared weights and biases in what is minimised.
    pub weight_decay: f64,
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
    /// Refuses settings that no training can start with.
    ///
    /// # Errors
    /// The first such key with its value, and what it may be.
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
