//! Small scenes for the tests of this crate and of those above it.

#![allow(clippy::unwrap_used, clippy::missing_panics_doc, clippy::must_use_candidate)] // called by tests alone

use super::{HostGaussians, Scene, SceneSpec};
use crate::config::preset;
use crate::config::types::ModelConfig;
use crate::device::DeviceName;

/// A spec for this model: a box of half size 1, white, harmonics of degree 0.
pub fn spec(model: ModelConfig) -> SceneSpec {
    SceneSpec {
        model,
        centre: [0.0; 3],
        half_size: [1.0; 3],
        background: [1.0; 3],
        deformed: true,
        sh_degree: 0,
        d3dgs: None,
        packed_from: None,
    }
}

/// Two Gaussians and a small field.
pub fn scene() -> Scene {
    scene_of("factorised")
}

/// The same with another encoder.
pub fn scene_of(encoder: &str) -> Scene {
    let device = DeviceName::all()[0].open().unwrap();
    let mut model = preset("best").unwrap().model;
    (model.resolution, model.time_knots, model.channels, model.width, model.sh_degree) = (4, 3, 4, 8, 0);
    (model.encoder, model.implicit_width) = (encoder.into(), 12);
    let gaussians = HostGaussians {
        means: vec![0.0; 6],
        rotations: [1.0, 0.0, 0.0, 0.0].repeat(2),
        log_scales: vec![-3.0; 6],
        opacity_logits: vec![0.0; 2],
        sh: vec![0.1; 6],
        sh_stride: 1,
        ..HostGaussians::default()
    };
    Scene::new(gaussians, spec(model), 0, &device)
}
