//! Training of the affinity field: each step applies the contrastive loss to pixels sampled from one view.

use super::network::{AffinityField, FEATURES};
use super::views::FineView;
use crate::model::params::to_vec;
use crate::rng::{Purpose, Rng};
use crate::train::optimizer::{AdamConstants, Optimizer};
use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use std::str::FromStr;
use volseggs_kernels::contrast::{Repulsion, contrast};
use volseggs_kernels::splat::contributors::Contributors;

/// At which scale a step evaluates the field, and which of the masks that cover a pixel is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MaskScale {
    /// One scale per step, drawn uniformly from [0, 1]; a pixel uses the smallest covering mask not below it, or else
    /// the largest. The field then learns the parts at each scale.
    #[default]
    Drawn,
    /// As in the paper: a pixel uses any mask that covers it, and each Gaussian is evaluated at the scale of its own
    /// mask. The masks of a view are put in a random order at each step, and a pixel uses the first that covers it; a
    /// Gaussian's mask is the one to whose pixels it contributes most. Here too a scale is the rank of a mask's spread,
    /// so that trained fields of both kinds are evaluated in the same way.
    Own,
}

impl FromStr for MaskScale {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "drawn" => Ok(Self::Drawn),
            "own" => Ok(Self::Own),
            _ => Err(format!("\"{text}\" is neither drawn nor own")),
        }
    }
}

/// Default margin of the contrastive loss, a cosine.
pub const MARGIN: f32 = 0.5;

/// Returns how masks repel with `margin`, a cosine: -1 or less gives the paper's loss, which has none.
#[must_use]
pub fn repulsion(margin: f32) -> Repulsion {
    if margin <= -1.0 { Repulsion::Cosine } else { Repulsion::Margin(margin) }
}

/// Options of [`train`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FineOptions {
    /// Number of steps; 5,000 in the paper.
    pub steps: usize,
    /// Pixels per step; 8,192 in the paper. With a margin, time grows with their square.
    pub pixels: usize,
    /// Learning rate of Adam; 1e-3 in the paper.
    pub rate: f64,
    /// How pixels of different masks repel.
    pub repulsion: Repulsion,
    /// At which scales the field is evaluated.
    pub mask_scale: MaskScale,
    /// Weight of the hierarchy loss: pixels of one mask also attract at a random larger scale, so that a part stays
    /// together within its whole; 0 disables it, as in the paper.
    pub hierarchy: f64,
    /// Seed of weights, views, scales and pixels.
    pub seed: u64,
}

impl Default for FineOptions {
    fn default() -> Self {
        Self {
            steps: 5000,
            pixels: 2048,
            rate: 1e-3,
            repulsion: repulsion(MARGIN),
            mask_scale: MaskScale::Drawn,
            hierarchy: 0.0,
            seed: 0,
        }
    }
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

/// Trains a field on views whose scales are ranked; `progress` receives each step and its loss, and stops training by
/// `false`.
///
/// # Errors
/// If there are no views, or a number is not finite.
pub fn train(
    views: &[FineView],
    options: &FineOptions,
    device: &Device,
    mut progress: impl FnMut(usize, f64) -> bool,
) -> Result<AffinityField, FineError> {
    if views.is_empty() {
        return Err(FineError::NoMasks);
    }
    let device = device.clone().autodiff();
    let mut field = AffinityField::new(options.seed, &device);
    let mut optimizer = Optimizer::new(AdamConstants { betas: [0.9, 0.999], epsilon: 1e-8, sh_rest: 1.0 });
    for step in 0..options.steps {
        let mut rng = Rng::new(options.seed, step as u64, Purpose::AffinitySteps);
        let view = &views[rng.below(views.len())];
        let batch = Batch::draw(view, options, &mut rng);
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
struct Batch {
    /// Rows of the chosen pixels.
    pixels: Contributors,
    /// The mask of each chosen pixel.
    masks: Vec<u32>,
    /// The scale at which each of the view's Gaussians is evaluated.
    scales: Vec<f32>,
    /// The larger scales of the hierarchy loss, if it has a weight.
    larger: Option<Vec<f32>>,
}

impl Batch {
    fn draw(view: &FineView, options: &FineOptions, rng: &mut Rng) -> Self {
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
fn loss(field: &AffinityField, view: &FineView, batch: &Batch, options: &FineOptions) -> (f64, Tensor<1>) {
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
    let (total, loss) = term(&batch.scales, options.repulsion, 1.0);
    let Some(larger) = &batch.larger else { return (total, loss) };
    let (more, part) = term(larger, Repulsion::None, options.hierarchy);
    (total + more, loss + part)
}

/// Samples up to `count` pixels of a view; returns their rows, and the mask of each by `mask`.
fn sample(view: &FineView, count: usize, rng: &mut Rng, mask: impl Fn(usize) -> u32) -> (Contributors, Vec<u32>) {
    let all = view.pixels.len();
    let chosen: Vec<usize> =
        if all <= count { (0..all).collect() } else { (0..count).map(|_| rng.below(all)).collect() };
    let mut rows = Contributors { offsets: vec![0], ..Contributors::default() };
    let mut masks = Vec::with_capacity(chosen.len());
    for p in chosen {
        let (indices, weights) = view.pixels.row(p);
        rows.indices.extend_from_slice(indices);
        rows.weights.extend_from_slice(weights);
        rows.offsets.push(rows.indices.len() as u32);
        masks.push(mask(p));
    }
    (rows, masks)
}

#[cfg(test)]
#[path = "train_tests.rs"]
mod tests;
