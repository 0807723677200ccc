//! The loss of a step (the paper's equations 5 to 8): a distance between two images, to which terms are added.
//!
//! Every term is a [`LossTerm`]. Those in [`LOSS_TERMS`] are built in; a program adds others by
//! `volseggs::extend::loss_term`. To add a built-in one, write a file here and a line in the table: `loss.extra.NAME` is
//! then its weight, unless it has keys of its own.

mod distance;
mod dssim;
mod fade;
mod smoothness;

pub use distance::photometric;
pub use dssim::{dssim, dssim_weight};
pub use fade::fading;
pub use smoothness::smoothness;

use crate::config::types::Config;
use crate::data::Camera;
use crate::model::Scene;
use crate::registry::{NotRegistered, Registry};
use crate::train::schedule::Stage;
use burn::tensor::Tensor;
use volseggs_kernels::splat::SplatInputs;

/// All terms, in the order in which they are added.
pub static LOSS_TERMS: Registry<dyn LossTerm> = Registry::new(
    "loss term",
    &[("dssim", &dssim::Dssim), ("smoothness", &smoothness::Smoothness), ("fade", &fade::Fade)],
);

/// Input of a loss term at one training step. All tensors are on one device; those of the scene have gradients.
#[derive(Clone, Copy, Debug)]
pub struct LossInput<'a> {
    /// The rendered image `[H, W, 4]`: colour over the background, and alpha; in [0, 1] or slightly beyond.
    pub image: &'a Tensor<3>,
    /// The training image in the same form, in [0, 1]; a constant.
    pub target: &'a Tensor<3>,
    /// The canonical Gaussians (`scene.gaussians`), the deformation field (`scene.field`).
    pub scene: &'a Scene,
    /// The N Gaussians at this time: means `[N, 3]`, rotations `[N, 4]`, log-scales `[N, 3]`, opacity logits `[N]`,
    /// colour coefficients `[N, K, 3]`.
    pub gaussians: &'a SplatInputs,
    /// The view's camera.
    pub camera: &'a Camera,
    /// The configuration of the run.
    pub config: &'a Config,
    /// Warm-up (the canonical Gaussians are drawn at every time) or joint training, with the step within it.
    pub stage: Stage,
    /// Step of the whole run, from 0.
    pub step: usize,
    /// The view's time in [0, 1].
    pub time: f32,
}

/// A term that is added, times its weight, to the loss of a step.
///
/// The distance is a mean over pixels, so a term that is also a mean keeps its relative weight when images or the
/// number of Gaussians change. It must be differentiable by burn: made of tensor operations on `image`, `at` or the
/// parameters of `scene`. A non-finite value stops the run.
pub trait LossTerm: Send + Sync {
    /// Returns the term's value before its weight, `[1]`. It is not called at steps at which its weight is 0.
    fn loss(&self, seen: &LossInput<'_>) -> Tensor<1>;

    /// Returns its weight at a step, for a term with keys of its own; `None` if it is `loss.extra.NAME`.
    fn weight(&self, _: &Config, _: Stage) -> Option<f64> {
        None
    }

    /// Rejects settings with which it would have no effect, or another than stated.
    ///
    /// # Errors
    /// The first such key with its value, and what to do.
    fn check(&self, _: &Config) -> Result<(), String> {
        Ok(())
    }

    /// Returns the seconds of CPU time that it takes over the whole run for each pixel of a view; for the estimate of a
    /// sweep.
    fn seconds_per_pixel(&self, _: &Config) -> f64 {
        0.0
    }
}

/// Returns the loss term of that name.
///
/// # Errors
/// [`NotRegistered`], which lists the registered names.
pub fn find_loss_term(name: &str) -> Result<&'static dyn LossTerm, NotRegistered> {
    LOSS_TERMS.get(name)
}

/// Rejects names in `loss.extra` that have no term of that weight, and settings that a term rejects.
///
/// # Errors
/// The first such key with its value, and what to do.
pub fn check(config: &Config) -> Result<(), String> {
    let all = LOSS_TERMS.all();
    let has_own_keys = |term: &dyn LossTerm| term.weight(config, Stage::Joint(0)).is_some();
    for name in config.loss.extra.keys() {
        match find_loss_term(name) {
            Ok(term) if has_own_keys(term) => {
                return Err(format!("loss.extra.{name}: this term has keys of its own, see `volseggs config show`"));
            }
            Ok(_) => {}
            Err(mut error) => {
                let extra = all.iter().filter(|(_, term)| !has_own_keys(*term));
                error.known = extra.map(|(name, _)| name.clone()).collect();
                return Err(format!("loss.extra: {error}"));
            }
        }
    }
    all.into_iter().try_for_each(|(_, term)| term.check(config))
}

/// Returns the seconds of CPU time that the terms take over the whole run for each pixel of a view.
pub fn seconds_per_pixel(config: &Config) -> f64 {
    LOSS_TERMS.all().into_iter().map(|(_, term)| term.seconds_per_pixel(config)).sum()
}

/// The terms of a training: all that were registered when it began.
pub struct LossTerms(Vec<(String, &'static dyn LossTerm)>);

impl LossTerms {
    /// Returns the terms that are registered now.
    pub fn registered() -> Self {
        Self(LOSS_TERMS.all())
    }

    /// Returns `loss` with every term added whose weight is not 0 at this step.
    pub fn add_to(&self, loss: Tensor<1>, seen: &LossInput<'_>) -> Tensor<1> {
        self.0.iter().fold(loss, |sum, (name, term)| {
            let own = term.weight(seen.config, seen.stage);
            match own.or_else(|| seen.config.loss.extra.get(name).copied()).unwrap_or(0.0) {
                0.0 => sum,
                1.0 => sum + term.loss(seen),
                weight => sum + term.loss(seen).mul_scalar(weight as f32),
            }
        })
    }
}

impl std::fmt::Debug for LossTerms {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.0.iter().map(|(name, _)| name)).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_term_with_keys_of_its_own_is_not_an_extra_one() {
        let mut config = Config::default();
        check(&config).unwrap();
        config.loss.extra.insert("dssim".into(), 0.1);
        let refused = check(&config).unwrap_err();
        assert!(refused.contains("loss.extra.dssim") && refused.contains("keys of its own"), "{refused}");
    }
}
