//! The Gaussians that contribute to a pixel, with their weights: the rows of the rendering matrix.
//!
//! A rendered pixel is `sum_i w_i c_i` with `w_i = alpha_i T_i` (3DGS, Kerbl et al. 2023, eq. 3). Here the `w_i`
//! themselves are listed, for chosen pixels and frozen geometry: for picking, for mask voting and for training features
//! on sampled pixels. This file holds the lists; `cpu` and `cube` find them, `products` multiplies with them, and `ops`
//! is the op on tensors. Nothing here is differentiable with respect to the geometry.

mod cpu;
#[cfg(feature = "cube")]
mod cube;
mod ops;
mod products;
pub mod reference;

use crate::splat::{SplatInputs, SplatSettings};
use burn::backend::Dispatch;
use thiserror::Error;

pub use ops::{ContributorsOps, ContributorsOutput};

/// Why contributors cannot be listed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ContributorsError {
    /// A pixel outside the image.
    #[error(
        "contributors: pixels[{position}] is {pixel}, but the image has {width}x{height} pixels; give y * {width} + x"
    )]
    PixelOutOfImage {
        /// Position in the list of pixels.
        position: usize,
        /// The pixel number found there.
        pixel: u32,
        /// Image width in pixels.
        width: usize,
        /// Image height in pixels.
        height: usize,
    },
    /// More contributions, or more pixels, than 32-bit offsets can count.
    #[error("contributors: {count} contributions do not fit 32-bit offsets; ask for fewer pixels at a time")]
    TooMany {
        /// Their number.
        count: u64,
    },
}

/// Lists the Gaussians blended into each of `pixels` (`y * width + x`, any order, repeats allowed), nearest first, with
/// the weights `alpha * T` that make up the image. The work is done on the device; the lists are on the host.
///
/// # Errors
/// A pixel outside the image, or more contributions than 32 bits can count.
///
/// # Panics
/// As [`crate::splat::splat`], and if a tensor cannot be read.
pub fn contributors(
    inputs: &SplatInputs,
    settings: &SplatSettings,
    pixels: &[u32],
) -> Result<Contributors, ContributorsError> {
    inputs.check(settings);
    let plain = inputs.clone().without_gradients(); // weights do not depend on colours
    Dispatch::contributors(plain.with_seen_opacities(settings).into_tensors(), *settings, pixels.to_vec()).lists
}

/// Checks that the pixels are not too many and lie in the image; the error names the first that does not.
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
    /// `alpha * T` of each, `[E]`: positive, with a sum of at most 1 over a pixel.
    pub weights: Vec<f32>,
}

impl Contributors {
    /// Number of pixels, P.
    pub fn len(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// Returns true if no pixel was requested.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the Gaussians and weights of pixel `p` (its position in the list of requested pixels), nearest first.
    ///
    /// # Panics
    /// If `p` is not below [`Self::len`].
    pub fn row(&self, p: usize) -> (&[u32], &[f32]) {
        let range = self.offsets[p] as usize..self.offsets[p + 1] as usize;
        (&self.indices[range.clone()], &self.weights[range])
    }

    /// Returns the lists of the pixels `chosen` alone, in that order.
    ///
    /// # Panics
    /// As [`Self::row`].
    pub fn rows(&self, chosen: &[usize]) -> Self {
        let mut out = Self { offsets: vec![0], ..Self::default() };
        for &p in chosen {
            let (indices, weights) = self.row(p);
            out.indices.extend_from_slice(indices);
            out.weights.extend_from_slice(weights);
            out.offsets.push(out.indices.len() as u32);
        }
        out
    }

    /// Iterates over the pairs of Gaussian and weight of [`Self::row`].
    ///
    /// # Panics
    /// As [`Self::row`].
    pub fn pairs(&self, p: usize) -> impl Iterator<Item = (u32, f32)> {
        let (indices, weights) = self.row(p);
        indices.iter().copied().zip(weights.iter().copied())
    }

    /// Returns the Gaussian with the largest weight, the nearest on ties; `None` where nothing was drawn.
    ///
    /// # Panics
    /// As [`Self::row`].
    pub fn heaviest(&self, p: usize) -> Option<(u32, f32)> {
        self.pairs(p).reduce(|best, next| if next.1 > best.1 { next } else { best })
    }

    /// Returns the nearest contributing Gaussian, however faint; `None` where nothing was drawn.
    ///
    /// # Panics
    /// As [`Self::row`].
    pub fn front(&self, p: usize) -> Option<(u32, f32)> {
        self.pairs(p).next()
    }
}

#[cfg(test)]
mod tests;
