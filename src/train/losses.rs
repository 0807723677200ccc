//! What is minimised (the paper's equations 5 to 8). To add a term, write a function of tensors here,
//! a weight in `config::types::LossConfig`, and add it in `Trainer::step`.

use crate::config::types::{LossConfig, LossKind, TvOrder};
use crate::model::encoder::{Encoder, FactorisedEncoder};
use burn::tensor::Tensor;
use volseggs_kernels::photometric::{Distance, Photometric, photometric_loss};
use volseggs_kernels::ssim::mean_ssim;
use volseggs_kernels::tv::{TvKind, TvWeights, total_variation};

/// Colour and alpha distance: mean over pixels and colour channels of the squared (`l2`, the paper's
/// equation 5) or absolute difference, plus `alpha` times the same for the alpha channel; and the mean squared
/// difference of the colours, for PSNR.
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

/// Smoothness of the encoder (equation 6, each tensor's sum as a mean), weights included; `None` if the
/// encoder has no grid or every weight is zero.
pub fn smoothness(encoder: &Encoder, config: &LossConfig) -> Option<Tensor<1>> {
    let Encoder::Factorised(encoder) = encoder else { return None };
    let weights = TvWeights {
        space: config.tv as f32,
        time: config.tv_time as f32,
        one_prior_space: config.one_prior as f32,
        one_prior_time: config.one_prior as f32,
    };
    let any = config.tv > 0.0 || config.tv_time > 0.0 || config.one_prior > 0.0;
    any.then(|| grid_smoothness(encoder, config.tv_kind, weights))
}

fn grid_smoothness(encoder: &FactorisedEncoder, kind: TvOrder, weights: TvWeights) -> Tensor<1> {
    let kind = match kind {
        TvOrder::First => TvKind::First,
        TvOrder::Second => TvKind::Second,
    };
    total_variation(encoder.planes.val(), encoder.lines.val(), encoder.times.val(), encoder.shape(), kind, weights)
}
