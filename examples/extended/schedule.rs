//! A schedule: rates rise at first, while Adam learns the size of the gradients, then fall along a cosine.

use std::f64::consts::PI;
use volseggs::config::types::OptimConfig;
use volseggs::extend::Schedule;

/// Linear warm-up, then half a period of a cosine.
pub struct WarmCosine {
    /// Fraction of the stage in which the rates rise.
    pub warm: f64,
    /// Initial and final rate, as a fraction of the full rate.
    pub last: f64,
}

impl Schedule for WarmCosine {
    fn factor(&self, progress: f64, _: &OptimConfig) -> f64 {
        let height = if progress < self.warm {
            progress / self.warm
        } else {
            0.5 * (1.0 + (PI * (progress - self.warm) / (1.0 - self.warm)).cos())
        };
        self.last + (1.0 - self.last) * height
    }
}
