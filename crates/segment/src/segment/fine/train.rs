//! Training of the affinity field: each step applies the contrastive loss to pixels sampled from one view.

use super::network::{AffinityField, FEATURES};
use super::views::FineView;
use crate::config::types::segment::{AffinityConfig, MaskScale};
use crate::model::params::to_vec;
use crate::rng::{Purpose, Rng};
use crate::train::optimizer::{AdamConstants, Optimizer};
use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use volseggs_kernels::contrast::{Repulsion, contrast};
use volseggs_kernels::splat::contributors::Contributors;

/// Returns how masks repel with `margin`, a cosine: -1 or less gives the paper's loss, which has none.
fn repulsion(margin: f32) -> Repulsion {
    if margin <= -1.0 { Repulsion::Cosine } else { Repulsion::Margin(margin) }
}

/// Why training stopped.
#[derive(Debug, thiserror::Error)]
pub enum FineError {
    /// No view has a mask that covers a pixel.
    #[error("no mask covers any pixel of any view: make masks first, or make them from other views")]
    NoMasks,
    /// A number is not finite.
    #[error("step {step}: {what} is not finite; lower the learning rate")]
    NotFinite {
        /// The step, from 0.
        step: usize,
        /// The loss or a tensor.
        what: String,
    },
}

/// Trains a field on views whose scales are ranked; `seed` is that of weights, views, scales and pixels. `progress` receives each step and its loss, and stops training by
/// `false`.
///
/// # Errors
/// If there are no views, or a number is not finite.
pub fn train(
    views: &[FineView],
    options: &AffinityConfig,
    seed: u64,
    device: &Device,
    mut progress: impl FnMut(usize, f64) -> bool,
) -> Result<AffinityField, FineError> {
    if views.is_empty() {
        return Err(FineError::NoMasks);
    }
    let device = device.clone().autodiff();
    let mut field = AffinityField::new(seed, &device);
    let mut optimizer = Optimizer::new(AdamConstants { betas: [0.9, 0.999], epsilon: 1e-8, sh_rest: 1.0 });
    for step in 0..options.steps {
        let mut rng = Rng::new(seed, step as u64, Purpose::AffinitySteps);
        let view = &views[rng.below(views.len())];
        let batch = AffinityBatch::draw(view, options, &mut rng);
        let (total, loss) = loss(&field, view, &batch, options);
        if !total.is_finite() {
            return Err(FineError::NotFinite { step, what: format!("the loss ({total})") });
        }
        let mut gradients = loss.backward();
        let (stepped, bad) = optimizer.step(field, &mut gradients, |_| Some(options.rate));
        field = stepped;
        if let Some(bad) = bad {
            return Err(FineError::NotFinite { step, what: bad.to_string() });
        }
        if !progress(step, total) {
            break;
        }
    }
    Ok(field.valid())
}

/// The data of one training step.
struct AffinityBatch {
    /// Rows of the chosen pixels.
    pixels: Contributors,
    /// The mask of each chosen pixel.
    masks: Vec<u32>,
    /// The scale at which each of the view's Gaussians is evaluated.
    scales: Vec<f32>,
    /// The larger scales of the hierarchy loss, if it has a weight.
    larger: Option<Vec<f32>>,
}

impl AffinityBatch {
    fn draw(view: &FineView, options: &AffinityConfig, rng: &mut Rng) -> Self {
        let n = view.globals.len();
        let (pixels, masks, scales) = match options.mask_scale {
            MaskScale::Drawn => {
                let scale = rng.uniform();
                let (pixels, masks) = sample(view, options.pixels, rng, |p| view.mask(p, scale));
                (pixels, masks, vec![scale; n])
            }
            MaskScale::Own => {
                let mut place: Vec<u32> = (0..view.scales.len() as u32).collect();
                rng.shuffle(&mut place);
                let first =
                    |p: usize| view.covering(p).iter().copied().min_by_key(|&m| place[m as usize]).unwrap_or_default();
                let (pixels, masks) = sample(view, options.pixels, rng, first);
                let scales = own_scales(view, &pixels, &masks);
                (pixels, masks, scales)
            }
        };
        let larger = (options.hierarchy > 0.0).then(|| {
            let up = rng.uniform();
            scales.iter().map(|s| s + (1.0 - s) * up).collect()
        });
        Self { pixels, masks, scales, larger }
    }
}

/// Returns the scale of each Gaussian's own mask: the one to whose pixels it contributes most, the first of equals; 0
/// for Gaussians in no pixel, whose features have no effect.
fn own_scales(view: &FineView, pixels: &Contributors, masks: &[u32]) -> Vec<f32> {
    let mut given: Vec<(u32, u32, f32)> = Vec::with_capacity(pixels.indices.len());
    for (p, &mask) in masks.iter().enumerate() {
        let (indices, weights) = pixels.row(p);
        given.extend(indices.iter().zip(weights).map(|(&i, &w)| (i, mask, w)));
    }
    // a stable sort, so that each sum has a fixed order
    given.sort_by_key(|&(gaussian, mask, _)| (gaussian, mask));
    let (mut scales, mut most) = (vec![0.0; view.globals.len()], vec![0.0f32; view.globals.len()]);
    for part in given.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        let (gaussian, sum) = (part[0].0 as usize, part.iter().map(|g| g.2).sum::<f32>());
        if sum > most[gaussian] {
            (most[gaussian], scales[gaussian]) = (sum, view.scales[part[0].1 as usize]);
        }
    }
    scales
}

/// Returns the loss of a batch, and a tensor with the same gradient with respect to the field's parameters.
fn loss(field: &AffinityField, view: &FineView, batch: &AffinityBatch, options: &AffinityConfig) -> (f64, Tensor<1>) {
    let n = view.encoded.len() / super::network::ENCODED;
    let term = |scales: &[f32], repulsion: Repulsion, weight: f64| {
        let features = field.forward_each(&view.encoded, scales);
        let rendered = batch.pixels.gather(&to_vec(features.clone().inner()), FEATURES);
        let out = contrast(&rendered, &batch.masks, repulsion);
        let slopes = batch.pixels.scatter(&out.gradient, n, FEATURES);
        let slopes = Tensor::<2>::from_data(TensorData::new(slopes, [n, FEATURES]), &features.device());
        // the sum of features times constant slopes has the slopes as its gradient
        (weight * out.loss, (features * slopes).sum() * weight)
    };
    let (total, loss) = term(&batch.scales, repulsion(options.margin), 1.0);
    let Some(larger) = &batch.larger else { return (total, loss) };
    let (more, part) = term(larger, Repulsion::None, options.hierarchy);
    (total + more, loss + part)
}

/// Samples up to `count` pixels of a view; returns their rows, and the mask of each by `mask`.
fn sample(view: &FineView, count: usize, rng: &mut Rng, mask: impl Fn(usize) -> u32) -> (Contributors, Vec<u32>) {
    let chosen = view.draw(count, rng);
    (view.pixels.rows(&chosen), chosen.into_iter().map(mask).collect())
}

#[cfg(test)]
#[path = "train_tests.rs"]
mod tests;
