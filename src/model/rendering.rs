//! How a model's Gaussians are drawn, beside the camera.

use volseggs_kernels::Camera;
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
}

impl Rendering {
    /// The settings for the view of `camera`.
    #[must_use]
    pub fn seen_by(self, camera: Camera) -> SplatSettings {
        let Self { background, sh_degree, dilation } = self;
        SplatSettings { camera, background, sh_degree, dilation }
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
