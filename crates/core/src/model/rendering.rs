//! How a model's Gaussians are drawn, beside the camera.

use volseggs_kernels::PinholeCamera;
use volseggs_kernels::path_opacity::MAX_EXPONENT;
use volseggs_kernels::splat::{MAX_DILATION, SplatSettings};

/// How a model's Gaussians are drawn, beside the camera: the settings used in training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rendering {
    /// Background colour.
    pub background: [f32; 3],
    /// Spherical-harmonics degree in use.
    pub sh_degree: usize,
    /// Amount by which each is widened on the screen, pixels squared.
    pub dilation: f32,
    /// How much opacities follow the length of the ray's path, see [`volseggs_kernels::path_opacity`].
    pub path_opacity: f32,
}

impl Rendering {
    /// The settings for the view of `camera`.
    pub fn seen_by(self, camera: PinholeCamera) -> SplatSettings {
        let Self { background, sh_degree, dilation, path_opacity } = self;
        SplatSettings { camera, background, sh_degree, dilation, path_opacity }
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
}

/// Rejects a dilation out of range.
///
/// # Errors
/// A message that names the range.
pub fn check_dilation(dilation: f32) -> Result<(), String> {
    if (0.0..=MAX_DILATION).contains(&dilation) {
        Ok(())
    } else {
        Err(format!("dilation = {dilation}: 0 to {MAX_DILATION}, in pixels squared"))
    }
}

/// Rejects an exponent of path lengths out of range.
///
/// # Errors
/// A message that names the range.
pub fn check_path_opacity(path_opacity: f32) -> Result<(), String> {
    if (0.0..=MAX_EXPONENT).contains(&path_opacity) {
        Ok(())
    } else {
        Err(format!("path_opacity = {path_opacity}: 0 to {MAX_EXPONENT}"))
    }
}
