//! What a model's Gaussians are drawn with, beside the camera.

use volseggs_kernels::Camera;
use volseggs_kernels::splat::{MOST_DILATION, SplatSettings};

/// What a model's Gaussians are drawn with, beside the camera: what was so in training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rendering {
    /// Colour behind them.
    pub background: [f32; 3],
    /// Spherical-harmonics degree in use.
    pub sh_degree: usize,
    /// What each is widened by on the screen, pixels squared.
    pub dilation: f32,
}

impl Rendering {
    /// As seen by `camera`.
    #[must_use]
    pub fn seen_by(self, camera: Camera) -> SplatSettings {
        let Self { background, sh_degree, dilation } = self;
        SplatSettings { camera, background, sh_degree, dilation }
    }

    /// The same of Gaussians that look alike from everywhere.
    #[must_use]
    pub fn flat(self) -> Self {
        Self { sh_degree: 0, ..self }
    }
}

/// Refuses a dilation that nothing is drawn with.
///
/// # Errors
/// A message.
pub fn check_dilation(dilation: f32) -> Result<(), String> {
    if (0.0..=MOST_DILATION).contains(&dilation) {
        Ok(())
    } else {
        Err(format!("dilation = {dilation}: 0 to {MOST_DILATION}, in pixels squared"))
    }
}
