//! SAGA (Cen et al., "Segment Any 3D Gaussians", AAAI 2025): a feature for each Gaussian, gated by a scale, learnt from
//! masks by contrast; a click selects what points the same way.
//!
//! A step takes one view and some of its masked pixels. Features are normalised, averaged over neighbours (half of them
//! left out at random), normalised again, summed over each pixel with the weights of rendering, and gated channel by
//! channel with `sigmoid(weight * scale + bias)`. At each of some scales, pixels that share a mask there attract,
//! others repel (`loss`). Gradients are written out by hand, and a step costs what its pixels touch.
//!
//! A re-implementation from descriptions, not the authors' program. What differs:
//! * Masks, their 3D scales and their ranks are those of the affinity field ([`FineView`]): the scale is the weighted
//!   spread of a mask's Gaussians, not that of points from depth, and faint contributions are left out.
//! * Adam steps only the Gaussians that a step touches, each with its own count of steps; the usual one also moves
//!   all others by their momentum.
//! * Features start with length 1 in random directions.
//! * Of pairs that are the same at all scales and not hard, a fixed eighth counts, in place of a drawn number of them.
//! * A pair's weight, 1 to 10, is linear in the product of one over the mean size of the masks of its two pixels.
//! * A click is a Gaussian, whose smoothed feature is compared, not a pixel and its rendered feature.
//! * Clustering of features and prompts other than a click are not here.

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
use step::Trainer;

/// How to train.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SagaOptions {
    /// Steps; the published 10,000.
    pub steps: usize,
    /// Pixels a step; the published 1,000. Time grows with their square.
    pub pixels: usize,
    /// Scales a step, beside the largest; the published 8. Time grows with them.
    pub scales: usize,
    /// Learning rate of Adam; the published 2.5e-3.
    pub rate: f32,
    /// Gaussians, itself among them, that a feature is averaged over; the published 16. At least 1.
    pub neighbours: usize,
    /// Part of the neighbours that a training step leaves out, in [0, 1); the published 0.5.
    pub dropout: f32,
    /// Below this cosine a pair that should be alike is hard; the published 0.75.
    pub hard_alike: f32,
    /// Above this cosine a pair that should differ is hard; the published 0.5.
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
    /// There is nothing to learn from.
    #[error("no mask covers any pixel of any view: make masks first, or from other views")]
    NoMasks,
    /// A number is not finite.
    #[error("step {step}: the loss is {loss}; lower the learning rate")]
    NotFinite {
        /// The step, from 0.
        step: usize,
        /// What it came to.
        loss: f64,
    },
    /// The positions are not points.
    #[error(transparent)]
    Points(#[from] PointsError),
}

/// Trains features for the Gaussians with `means` `[N, 3]` (world units) on views of them, whose scales are ranked
/// ([`rank_scales`](crate::segment::fine::views::rank_scales)); `progress` is told each step's loss and may end
/// training by `false`.
///
/// # Errors
/// If there are no views, the loss is not finite, or `means` is not a whole number of rows.
///
/// # Panics
/// If a view shows a Gaussian that is not below N: it is of another scene.
pub fn train(
    views: &[FineView],
    means: &[f32],
    options: &SagaOptions,
    mut progress: impl FnMut(usize, f64) -> bool,
) -> Result<SagaModel, SagaError> {
    if views.is_empty() {
        return Err(SagaError::NoMasks);
    }
    let mut trainer = Trainer::new(views, means, options)?;
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
