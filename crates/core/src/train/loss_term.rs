//! Loss terms.

use crate::data::Camera;
use crate::model::Scene;
use crate::registry::{NotRegistered, Registry};
use crate::train::schedule::Stage;
use burn::tensor::Tensor;
use std::sync::Arc;
use volseggs_kernels::splat::SplatInputs;

/// Loss terms by name.
pub static LOSS_TERMS: Registry<dyn LossTerm> = Registry::new("loss term");

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
    pub at: &'a SplatInputs,
    /// The view's camera.
    pub camera: &'a Camera,
    /// Warm-up (the canonical Gaussians are drawn at every time) or joint training, with the step within it.
    pub stage: Stage,
    /// Step of the whole run, from 0.
    pub step: usize,
    /// The view's time in [0, 1].
    pub time: f32,
}

/// A term added to the loss of every step, times its weight `loss.extra.NAME`.
///
/// The built-in loss is a mean over pixels, so a term that is also a mean keeps its relative weight when images or the
/// number of Gaussians change. It must be differentiable by burn: made of tensor operations on `image`, `at` or the
/// parameters of `scene`. A non-finite value stops the run.
pub trait LossTerm: Send + Sync {
    /// Returns the term's value before its weight, `[1]`.
    fn loss(&self, seen: &LossInput<'_>) -> Tensor<1>;
}

/// Returns the loss term of that name.
///
/// # Errors
/// [`NotRegistered`], which lists the registered names.
pub fn find_loss_term(name: &str) -> Result<Arc<dyn LossTerm>, NotRegistered> {
    LOSS_TERMS.get(name)
}
