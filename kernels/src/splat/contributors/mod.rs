//! Which Gaussians contribute to a pixel, with which weight: the rows of the rendering matrix.
//!
//! A rendered pixel is `sum_i w_i c_i` with `w_i = alpha_i T_i` (3DGS, Kerbl et al. 2023, eq. 3). Here the
//! `w_i` themselves are listed, for chosen pixels and frozen geometry: for picking, for votes of masks and
//! for training features on sampled pixels. This file holds the lists; how they are found is in `cpu` and `cube`,
//! products with them in `products`, the op on tensors in `ops`. Nothing here is differentiable with respect to the geometry.

mod cpu;
#[cfg(feature = "cube")]
mod cube;
mod ops;
mod products;
pub mod reference;

use crate::splat::{SplatInputs, SplatSettings};
use burn::backend::Dispatch;
use burn::tensor::Tensor;
use thiserror::Error;

pub use ops::{ContributorsOps, ContributorsOutput};

/// Why no lists came back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ContributorsError {
    /// A pixel that the image does not have.
    #[error(
        "contributors: pixels[{position}] is {pixel}, but the image has {width}x{height} pixels; give y * {width} + x"
    )]
    PixelOutOfImage {
        /// Position in the list of pixels.
        position: usize,
        /// The number found there.
        pixel: u32,
        /// Image width in pixels.
        width: usize,
        /// Image height in pixels.
        height: usize,
    },
    /// More contributions, or more pixels, than offsets of 32 bits can count.
    #[error("contributors: {count} contributions do not fit 32-bit offsets; ask for fewer pixels at a time")]
    TooMany {
        /// How many.
        count: u64,
    },
}

/// Which Gaussians are blended into each of `pixels` (`y * width + x`, any order, repeats allowed), nearest first,
/// with the weights `alpha * T` that the image is made of. The work is done on the device, the lists are on the host.
///
/// # Errors
/// A pixel that the image does not have, or more contributions than 32 bits count.
///
/// # Panics
/// As [`crate::splat::splat`], and if a tensor cannot be read.
pub fn contributors(
    inputs: &SplatInputs,
    settings: &SplatSettings,
    pixels: &[u32],
) -> Result<Contributors, ContributorsError> {
    fn plain<const D: usize>(tensor: &Tensor<D>) -> Tensor<D> {
        let tensor = tensor.clone();
        if tensor.device().is_autodiff() { tensor.inner() } else { tensor }
    }
    let plain = SplatInputs {
        means: plain(&inputs.means),
        rotations: plain(&inputs.rotations),
        log_scales: plain(&inputs.log_scales),
        opacity_logits: plain(&inputs.opacity_logits),
        sh: plain(&inputs.sh),
        screen_offsets: inputs.screen_offsets.as_ref().map(plain),
        shading: None, // weights do not depend on colours
    };
    Dispatch::contributors(plain.into_tensors(), *settings, pixels.to_vec()).lists
}

/// The first pixel that the image does not have, or too many of them.
pub(crate) fn check_pixels(pixels: &[u32], settings: &SplatSettings) -> Result<(), ContributorsError> {
    let (width, height) = (settings.camera.width, settings.camera.height);
    if u32::try_from(pixels.len()).is_err() {
        return Err(ContributorsError::TooMany { count: pixels.len() as u64 });
    }
    match pixels.iter().position(|&p| p as usize >= width * height) {
        Some(position) => Err(ContributorsError::PixelOutOfImage { position, pixel: pixels[position], width, height }),
        None => Ok(()),
    }
}

/// The Gaussians that contribute to each of P pixels, nearest first: a sparse `[P, N]` matrix in CSR form
/// with E entries.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Contributors {
    /// Where the list of each pixel starts, `[P + 1]`.
    pub offsets: Vec<u32>,
    /// Indices of Gaussians, `[E]`.
    pub indices: Vec<u32>,
    /// `alpha * T` of each, `[E]`: positive, and at most 1 in sum over a pixel.
    pub weights: Vec<f32>,
}

impl Contributors {
    /// Number of pixels, P.
    pub fn len(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// True if no pixel was asked for.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Gaussians and weights of pixel `p` (its position in the list asked for), nearest first.
    ///
    /// # Panics
    /// If `p` is not below [`Self::len`].
    pub fn row(&self, p: usize) -> (&[u32], &[f32]) {
        let range = self.offsets[p] as usize..self.offsets[p + 1] as usize;
        (&self.indices[range.clone()], &self.weights[range])
    }

    /// The same, Gaussian by Gaussian.
    ///
    /// # Panics
    /// As [`Self::row`].
    pub fn pairs(&self, p: usize) -> impl Iterator<Item = (u32, f32)> {
        let (indices, weights) = self.row(p);
        indices.iter().copied().zip(weights.iter().copied())
    }

    /// The Gaussian with the largest weight, the nearest of equals; `None` where nothing was drawn.
    ///
    /// # Panics
    /// As [`Self::row`].
    pub fn heaviest(&self, p: usize) -> Option<(u32, f32)> {
        self.pairs(p).reduce(|best, next| if next.1 > best.1 { next } else { best })
    }

    /// The nearest contributing Gaussian, however faint; `None` where nothing was drawn.
    ///
    /// # Panics
    /// As [`Self::row`].
    pub fn front(&self, p: usize) -> Option<(u32, f32)> {
        self.pairs(p).next()
    }
}

#[cfg(test)]
mod tests;
