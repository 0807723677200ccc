//! How Gaussians are drawn: everything about a picture that is not a tensor.

use super::{DILATION, MAX_DILATION};
use crate::PinholeCamera;
use crate::path_opacity::MAX_EXPONENT;

/// How Gaussians are drawn, beside the camera: in the same way as in training. The default is that of 3DGS, of degree 0
/// over black.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rendering {
    /// Background colour, RGB.
    pub background: [f32; 3],
    /// Spherical-harmonics degree in use, 0 to 3, or to 4 where the coefficients are of even bands; those beyond it are
    /// ignored and get no gradient.
    pub sh_degree: usize,
    /// Added to the diagonal of the projected covariance, pixels squared, so that a small Gaussian does not fall
    /// between pixel centres; 0 to [`MAX_DILATION`], [`DILATION`] in 3DGS.
    pub dilation: f32,
    /// How much an opacity follows the length of the ray's path through the Gaussian: the exponent of
    /// [`crate::path_opacity`], 0 to 1, 0 in 3DGS. [`super::splat_covariances`] allows 0 alone.
    pub path_opacity: f32,
}

impl Default for Rendering {
    fn default() -> Self {
        Self { background: [0.0; 3], sh_degree: 0, dilation: DILATION, path_opacity: 0.0 }
    }
}

/// A camera, and how Gaussians are drawn for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplatSettings {
    /// The camera, with the image size.
    pub camera: PinholeCamera,
    /// How Gaussians are drawn.
    pub rendering: Rendering,
}

impl Rendering {
    /// The settings for the view of `camera`.
    pub fn seen_by(self, camera: PinholeCamera) -> SplatSettings {
        SplatSettings { camera, rendering: self }
    }

    /// The standard deviation by which the dilation widens Gaussians where a pixel has this side, in its unit.
    pub fn widening(&self, pixel: f64) -> f64 {
        pixel * f64::from(self.dilation).sqrt()
    }

    /// The same for Gaussians whose colour does not depend on the view.
    #[must_use]
    pub fn flat(self) -> Self {
        Self { sh_degree: 0, ..self }
    }

    /// Rejects numbers out of range.
    ///
    /// # Errors
    /// A message that names the first and its range.
    pub fn check(&self) -> Result<(), String> {
        let Self { dilation, path_opacity, .. } = self;
        if !(0.0..=MAX_DILATION).contains(dilation) {
            return Err(format!("dilation = {dilation}: 0 to {MAX_DILATION}, in pixels squared"));
        }
        if !(0.0..=MAX_EXPONENT).contains(path_opacity) {
            return Err(format!("path_opacity = {path_opacity}: 0 to {MAX_EXPONENT}"));
        }
        Ok(())
    }
}
