//! The distance between two images.

use crate::config::types::{LossConfig, LossKind};
use burn::tensor::Tensor;
use volseggs_kernels::photometric::{Distance, Photometric, photometric_loss};

/// Returns the distance in colour and alpha: mean over pixels and colour channels of the squared (`l2`, the paper's
/// equation 5) or absolute difference, plus `alpha` times the same for the alpha channel; and the mean squared
/// difference of the colours, for PSNR. `loss.weight` is not included.
///
/// `image` and `target` are `[H, W, 4]`.
pub fn photometric(image: Tensor<3>, target: Tensor<3>, config: &LossConfig) -> Photometric {
    let kind = match config.kind {
        LossKind::L1 => Distance::Absolute,
        LossKind::L2 => Distance::Squared,
    };
    photometric_loss(image, target, kind, config.alpha as f32)
}
