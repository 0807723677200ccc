//! What is minimised (the paper's equations 5 to 8). To add a term, write a function of tensors here,
//! a weight in `config::types::LossConfig`, and add it in `Trainer::step`; or register it, see [`crate::extend`].

use super::loss_term::{LossInput, LossTerm, find_loss_term};
use crate::config::types::{LossConfig, LossKind, TvOrder, TvReduction};
use crate::model::encoder::{Encoder, FactorisedEncoder};
use crate::registry::NotRegistered;
use burn::tensor::Tensor;
use std::sync::Arc;
use volseggs_kernels::photometric::{Distance, Photometric, photometric_loss};
use volseggs_kernels::splat::SplatInputs;
use volseggs_kernels::ssim::mean_ssim;
use volseggs_kernels::tv::{self, TvKind, TvWeights, total_variation};

/// Colour and alpha distance: mean over pixels and colour channels of the squared (`l2`, the paper's
/// equation 5) or absolute difference, plus `alpha` times the same for the alpha channel; and the mean squared
/// difference of the colours, for PSNR. `loss.weight` is not in it.
///
/// `image` and `target` are `[H, W, 4]`.
pub fn photometric(image: Tensor<3>, target: Tensor<3>, config: &LossConfig) -> Photometric {
    let kind = match config.kind {
        LossKind::L1 => Distance::Absolute,
        LossKind::L2 => Distance::Squared,
    };
    photometric_loss(image, target, kind, config.alpha as f32)
}

/// `1 - SSIM` of the colours (equation 7). `image` and `target` are `[H, W, 4]`. Returns `[1]`.
pub fn dssim(image: Tensor<3>, target: Tensor<3>) -> Tensor<1> {
    mean_ssim(image, target).neg().add_scalar(1.0)
}

/// Smoothness of the encoder, weights included; `None` if the encoder has no grid or every weight is zero.
///
/// Equation 6 sums the squared differences of every tensor (`loss.tv_reduction = "sum"`); the default takes their mean in
/// each tensor, along each axis of a plane by itself, and adds these up over the tensors of all levels, as the reference
/// code does. `loss.one_prior` always counts with the mean of each tensor.
pub fn smoothness(encoder: &Encoder, config: &LossConfig) -> Option<Tensor<1>> {
    let Encoder::Factorised(encoder) = encoder else { return None };
    let weights = TvWeights {
        space: config.tv as f32,
        time: config.tv_time as f32,
        one_prior_space: config.one_prior as f32,
        one_prior_time: config.one_prior as f32,
        reduction: match config.tv_reduction {
            TvReduction::Mean => tv::TvReduction::Mean,
            TvReduction::Sum => tv::TvReduction::Sum,
        },
    };
    let any = config.tv > 0.0 || config.tv_time > 0.0 || config.one_prior > 0.0;
    any.then(|| grid_smoothness(encoder, config.tv_kind, weights))
}

/// The registered loss terms that a configuration asks for, with their weights.
#[derive(Clone, Default)]
pub struct ExtraTerms(Vec<(String, f32, Arc<dyn LossTerm>)>);

impl ExtraTerms {
    /// The terms of `loss.extra`, in the order of their names; those of weight 0 are not taken in.
    ///
    /// # Errors
    /// The first name that is not registered, whatever its weight.
    pub fn new(config: &LossConfig) -> Result<Self, NotRegistered> {
        let find = |(name, weight): (&String, &f64)| Ok((name.clone(), *weight as f32, find_loss_term(name)?));
        let mut terms = config.extra.iter().map(find).collect::<Result<Vec<_>, _>>()?;
        terms.retain(|(_, weight, _)| *weight != 0.0);
        Ok(Self(terms))
    }

    /// The Gaussians at a time, kept for the terms; `None` if there are no terms.
    pub fn keep(&self, at: &SplatInputs) -> Option<SplatInputs> {
        (!self.0.is_empty()).then(|| at.clone())
    }

    /// `loss` with every term added.
    pub fn add_to(&self, loss: Tensor<1>, input: &LossInput<'_>) -> Tensor<1> {
        self.0.iter().fold(loss, |sum, (_, weight, term)| sum + term.loss(input).mul_scalar(*weight))
    }
}

impl std::fmt::Debug for ExtraTerms {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_map().entries(self.0.iter().map(|(name, weight, _)| (name, weight))).finish()
    }
}

fn grid_smoothness(encoder: &FactorisedEncoder, kind: TvOrder, weights: TvWeights) -> Tensor<1> {
    let kind = match kind {
        TvOrder::First => TvKind::First,
        TvOrder::Second => TvKind::Second,
    };
    total_variation(encoder.planes.val(), encoder.lines.val(), encoder.times.val(), encoder.shape(), kind, weights)
}
