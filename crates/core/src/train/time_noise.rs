//! Noise on the time of a step, which D3DGS calls annealed smooth training (its equation 6): neighbouring times learn
//! from each other, to a decreasing degree.

use crate::config::types::{Config, D3dgsConfig};
use crate::rng::{Purpose, Rng};

/// The mean interval of ascending training times; 0 for a single one.
pub(super) fn mean_interval(times: &[f64]) -> f64 {
    match times {
        [first, .., last] => (last - first) / (times.len() - 1) as f64,
        _ => 0.0,
    }
}

/// The noise of a training; none unless it has the network of D3DGS.
#[derive(Clone, Copy, Debug)]
pub(super) struct TimeNoise {
    seed: u64,
    /// Standard deviation at the first step, in intervals.
    size: f64,
    /// Spacing of the training times; the whole time range is 1.
    interval: f64,
    /// Steps of the whole run over which it decays to zero.
    steps: usize,
}

impl TimeNoise {
    /// Returns the noise that a configuration asks for, where `interval` is the spacing of training times.
    pub fn new(config: &Config, interval: f64) -> Self {
        let network = config.sections.get::<D3dgsConfig>().ok().flatten();
        let (size, steps) = network.map_or((0.0, 0), |network| (network.time_noise, network.time_noise_steps));
        Self { seed: config.seed, size, interval, steps }
    }

    /// Returns the time at which step `step` (of the whole run, from 0) deforms the Gaussians for a view at `time`. It may
    /// lie slightly outside [0, 1].
    pub fn noisy(&self, time: f64, step: usize) -> f32 {
        let left = 1.0 - step as f64 / self.steps.max(1) as f64;
        if left <= 0.0 || self.size == 0.0 {
            return time as f32;
        }
        let drawn = f64::from(Rng::new(self.seed, step as u64, Purpose::TimeNoise).normal());
        (time + drawn * self.size * self.interval * left) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::preset;

    #[test]
    fn noise_falls_to_nothing_and_follows_from_the_step() {
        let mut config = preset("best").unwrap();
        assert_eq!(TimeNoise::new(&config, 0.1).noisy(0.3, 0), 0.3);
        config.sections.set(&D3dgsConfig { time_noise: 0.5, time_noise_steps: 1000, ..D3dgsConfig::default() });
        let noisy = |step: usize| TimeNoise::new(&config, 0.1).noisy(0.3, step);
        let at = |from: usize| (from..from + 200).map(|s| f64::from(noisy(s)) - 0.3);
        let size = |from: usize| (at(from).map(|v| v * v).sum::<f64>() / 200.0).sqrt();
        // standard deviations of 0.05 at the start and half of that in the middle
        assert!((size(0) / (0.05 * 0.9) - 1.0).abs() < 0.15, "{}", size(0));
        assert!((size(400) / (0.05 * 0.5) - 1.0).abs() < 0.15, "{}", size(400));
        assert!((at(0).sum::<f64>() / 200.0).abs() < 0.01);
        assert_eq!((noisy(1000), noisy(5)), (0.3, noisy(5)));
        assert_eq!(TimeNoise::new(&config, 0.0).noisy(0.3, 5), 0.3);
    }

    #[test]
    fn intervals_are_those_of_the_times_that_are_trained() {
        assert!((mean_interval(&[0.4, 0.45, 0.5]) - 0.05).abs() < 1e-12);
        assert_eq!((mean_interval(&[0.0, 1.0]), mean_interval(&[0.7]), mean_interval(&[])), (1.0, 0.0, 0.0));
    }
}
