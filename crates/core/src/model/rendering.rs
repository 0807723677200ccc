//! How a model's Gaussians are drawn, as its configuration says.

use crate::config::types::ModelConfig;

pub use volseggs_kernels::splat::Rendering;

impl From<&ModelConfig> for Rendering {
    /// Of degree 0 over black: degree and background are those of a scene.
    fn from(config: &ModelConfig) -> Self {
        let ModelConfig { dilation, path_opacity, .. } = config;
        Self { dilation: *dilation as f32, path_opacity: *path_opacity as f32, ..Self::default() }
    }
}
