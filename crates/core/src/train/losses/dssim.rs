//! Structural dissimilarity of the colours (the paper's equation 7), `loss.dssim*`.

use super::{LossInput, LossTerm};
use crate::config::types::Config;
use crate::train::schedule::Stage;
use burn::tensor::Tensor;
use volseggs_kernels::ssim::mean_ssim;

/// Seconds of CPU time for each pixel of a step.
const SECONDS_PER_PIXEL: f64 = 2.0e-7;

/// `1 - SSIM`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Dssim;

impl LossTerm for Dssim {
    fn loss(&self, seen: &LossInput<'_>) -> Tensor<1> {
        dssim(seen.image.clone(), seen.target.clone())
    }

    fn weight(&self, config: &Config, stage: Stage) -> Option<f64> {
        Some(dssim_weight(config, stage))
    }

    fn check(&self, config: &Config) -> Result<(), String> {
        let loss = &config.loss;
        let in_warmup = loss.dssim_warmup && config.stages.warmup_steps > 0;
        if loss.dssim > 0.0 && loss.dssim_last == 0 && !in_warmup {
            return Err(format!(
                "loss.dssim = {}: has no effect with loss.dssim_last = 0; set that to the number of last steps in \
                 which it counts",
                loss.dssim
            ));
        }
        Ok(())
    }

    fn seconds_per_pixel(&self, config: &Config) -> f64 {
        // without a joint stage it is used in warm-up
        let steps = match config.stages.joint_steps {
            0 => config.stages.warmup_steps,
            joint => joint,
        };
        let used = if config.loss.dssim > 0.0 { config.loss.dssim_last.min(steps) } else { 0 };
        used as f64 * SECONDS_PER_PIXEL
    }
}

/// Returns `1 - SSIM` of the colours, `[1]`. `image` and `target` are `[H, W, 4]`.
pub fn dssim(image: Tensor<3>, target: Tensor<3>) -> Tensor<1> {
    mean_ssim(image, target).neg().add_scalar(1.0)
}

/// Weight of DSSIM: active in the last `loss.dssim_last` steps of the joint stage (of warm-up if there is no joint
/// stage), rising over the first `loss.dssim_ramp` of them. DSSIM's gradients are many times those of L2, and Adam's
/// second moment takes some hundred steps to learn their size; switched on at once, DSSIM sets the scene back. With
/// `loss.dssim_warmup` it also has its full weight in warm-up.
pub fn dssim_weight(config: &Config, stage: Stage) -> f64 {
    let stages = &config.stages;
    let (s, steps) = match stage {
        Stage::Joint(s) => (s, stages.joint_steps),
        Stage::Warmup(_) if config.loss.dssim_warmup => return config.loss.dssim,
        Stage::Warmup(s) if stages.joint_steps == 0 => (s, stages.warmup_steps),
        Stage::Warmup(_) => return 0.0,
    };
    let start = steps.saturating_sub(config.loss.dssim_last);
    if s < start || config.loss.dssim_last == 0 {
        return 0.0;
    }
    // a ramp longer than what is left would never reach the weight
    let ramp = config.loss.dssim_ramp.min(steps - start).max(1);
    let ramp = (s - start + 1) as f64 / ramp as f64;
    config.loss.dssim * ramp.min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::preset;
    use crate::config::types::DecayOver;

    #[test]
    fn dssim_may_count_from_the_first_step() {
        let mut config = preset("best").unwrap();
        (config.stages.warmup_steps, config.stages.joint_steps) = (3000, 27_000);
        (config.optim.decay_over, config.loss.dssim_warmup) = (DecayOver::Run, true);
        (config.loss.dssim_last, config.loss.dssim_ramp) = (27_000, 1);
        let weights = [Stage::Warmup(0), Stage::Warmup(2999), Stage::Joint(0), Stage::Joint(26_999)];
        assert_eq!(weights.map(|stage| dssim_weight(&config, stage)), [config.loss.dssim; 4]);
    }

    #[test]
    fn dssim_comes_late_and_rises() {
        let mut config = preset("best").unwrap();
        config.stages.joint_steps = 20_000;
        (config.loss.dssim, config.loss.dssim_ramp) = (0.2, 10);
        let weight = |s| dssim_weight(&config, Stage::Joint(s));
        assert_eq!(weight(14_999), 0.0);
        assert!((weight(15_000) - 0.02).abs() < 1e-12);
        assert_eq!((weight(15_009), weight(19_999)), (0.2, 0.2));
        assert_eq!(dssim_weight(&config, Stage::Warmup(499)), 0.0);
        // a static scene: the last steps of warm-up, or all of them
        (config.stages.warmup_steps, config.stages.joint_steps, config.loss.dssim_ramp) = (6000, 0, 1);
        assert_eq!([999, 1000, 5999].map(|s| dssim_weight(&config, Stage::Warmup(s))), [0.0, 0.2, 0.2]);
        config.loss.dssim_last = 6000;
        assert_eq!(dssim_weight(&config, Stage::Warmup(0)), 0.2);
        // the same without a joint stage as with one
        (config.loss.dssim_warmup, config.loss.dssim_last) = (true, 0);
        assert_eq!([0, 5999].map(|s| dssim_weight(&config, Stage::Warmup(s))), [0.2; 2]);
    }
}
