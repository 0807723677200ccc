//! Lens and distance of a dataset's training cameras: what pictures of a scene from all around need to know of its
//! dataset.

use super::camera::Camera;
use super::paths::{Lens, Sphere, orbit};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Elevation of an orbit above the equator, radians.
const ELEVATION: f64 = 20.0 * std::f64::consts::PI / 180.0;

/// The lens and the camera positions of a dataset.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Surroundings {
    /// The lens.
    pub lens: Lens,
    /// Sphere around the scene's centre on which its cameras stand.
    pub sphere: Sphere,
}

impl Surroundings {
    /// Those of a dataset whose first training camera is `camera`, around a scene with this `centre`.
    pub fn new(camera: &Camera, centre: DVec3) -> Self {
        let lens = Lens { fov_x: camera.fov_x(), width: camera.width, height: camera.height };
        Self { lens, sphere: Sphere::through(camera, centre) }
    }

    /// The side of a pixel at the scene's centre, scene units.
    pub fn pixel(&self) -> f64 {
        2.0 * self.sphere.radius * (0.5 * self.lens.fov_x).tan() / f64::from(self.lens.width)
    }

    /// These surroundings for pictures `width` pixels wide, with the same aspect ratio.
    #[must_use]
    pub fn sized(mut self, width: u32) -> Self {
        let full = self.lens;
        let height = (f64::from(full.height) * f64::from(width) / f64::from(full.width)).round().max(1.0) as u32;
        self.lens = Lens { width, height, ..full };
        self
    }

    /// `frames` cameras on a circle around the scene, a little above its equator.
    pub fn orbit(&self, frames: usize) -> Vec<Camera> {
        orbit(frames, self.sphere, ELEVATION, self.lens)
    }
}
