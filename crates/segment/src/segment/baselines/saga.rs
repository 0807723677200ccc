//! SAGA (Cen et al., "Segment Any 3D Gaussians", AAAI 2025): a feature for each Gaussian, gated by a scale, learnt from
//! masks with a contrastive loss; a click selects the Gaussians with similar features.
//!
//! A step uses one view and some of its masked pixels. Features are normalised, averaged over neighbours (half of them
//! dropped at random), normalised again, summed over each pixel with the rendering weights, and gated channel by
//! channel with `sigmoid(weight * scale + bias)`. At each of several scales, pixels that share a mask there attract,
//! others repel (`loss`). Gradients are written by hand, and the cost of a step depends on what its pixels touch.
//!
//! This is a re-implementation from descriptions, not the authors' program. Differences:
//! * Masks, their 3D scales and their ranks are those of the affinity field ([`FineView`]): the scale is the weighted
//!   spread of a mask's Gaussians, not that of points from depth, and faint contributions are skipped.
//! * Adam updates only the Gaussians that a step touches, each with its own step count; the usual one also moves all
//!   others by their momentum.
//! * Features start with length 1 in random directions.
//! * Of the pairs that are the same at all scales and not hard, one in eight counts, instead of a randomly drawn
//!   number.
//! * A pair's weight, 1 to 10, is linear in the product of one over the mean size of the masks of its two pixels.
//! * A click is a Gaussian, whose smoothed feature is compared, not a pixel and its rendered feature.
//! * Clustering of features and prompts other than a click are not implemented.

mod loss;
mod model;
mod smooth;
mod step;
#[cfg(test)]
mod tests;

use crate::points::PointsError;
use crate::rng::{Purpose, Rng};
use crate::segment::fine::views::FineView;
pub use model::SagaModel;
use step::SagaTrainer;

/// Options of [`train`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SagaOptions {
    /// Number of steps; 10,000 as published.
    pub steps: usize,
    /// Pixels per step; 1,000 as published. Time grows with their square.
    pub pixels: usize,
    /// Scales per step besides the largest; 8 as published. Time grows with their number.
    pub scales: usize,
    /// Learning rate of Adam; 2.5e-3 as published.
    pub rate: f32,
    /// Gaussians that a feature is averaged over, including its own; 16 as published. At least 1.
    pub neighbours: usize,
    /// Fraction of the neighbours that a training step drops, in [0, 1); 0.5 as published.
    pub dropout: f32,
    /// Cosine below which a pair that should be similar is hard; 0.75 as published.
    pub hard_alike: f32,
    /// Cosine above which a pair that should differ is hard; 0.5 as published.
    pub hard_apart: f32,
    /// Seed of features, gate, views, scales and pixels.
    pub seed: u64,
}

impl Default for SagaOptions {
    fn default() -> Self {
        Self {
            steps: 10_000,
            pixels: 1000,
            scales: 8,
            rate: 2.5e-3,
            neighbours: 16,
            dropout: 0.5,
            hard_alike: 0.75,
            hard_apart: 0.5,
            seed: 0,
        }
    }
}

/// Why training stopped.
#[derive(Debug, thiserror::Error)]
pub enum SagaError {
    /// No view has a mask that covers a pixel.
    #[error("no mask covers any pixel of any view: make masks first, or make them from other views")]
    NoMasks,
    /// The loss is not finite.
    #[error("step {step}: the loss is {loss}; lower the learning rate")]
    NotFinite {
        /// The step, from 0.
        step: usize,
        /// Value of the loss.
        loss: f64,
    },
    /// The positions are not rows of three.
    #[error(transparent)]
    Points(#[from] PointsError),
}

/// Trains features for the Gaussians with `means` `[N, 3]` (scene units) on views of them, whose scales are ranked
/// ([`rank_scales`](crate::segment::fine::views::rank_scales)); `progress` receives each step and its loss, and stops
/// training by `false`.
///
/// # Errors
/// If there are no views, the loss is not finite, or `means` is not a whole number of rows.
///
/// # Panics
/// If a view shows a Gaussian whose index is not below N, that is, one of another scene.
pub fn train(
    views: &[FineView],
    means: &[f32],
    options: &SagaOptions,
    mut progress: impl FnMut(usize, f64) -> bool,
) -> Result<SagaModel, SagaError> {
    if views.is_empty() {
        return Err(SagaError::NoMasks);
    }
    let mut trainer = SagaTrainer::new(views, means, options)?;
    for step in 0..options.steps {
        let mut rng = Rng::new(options.seed, step as u64 + 1, Purpose::GaussianFeatures);
        let view = rng.below(views.len());
        let batch = trainer.batch(view, &mut rng);
        let slopes = trainer.loss(&batch);
        if !slopes.loss.is_finite() {
            return Err(SagaError::NotFinite { step, loss: slopes.loss });
        }
        trainer.step(&batch, &slopes);
        if !progress(step, slopes.loss) {
            break;
        }
    }
    Ok(trainer.model(means))
}
