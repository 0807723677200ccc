//! What the trained model of every method can do: draw any view at any time, and be saved to a file.

use super::Scene;
use super::params::{self, HostTensor, to_vec};
use super::scene_file::SceneError;
use burn::tensor::{Device, Tensor};
use glam::DVec3;
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::path::Path;
use volseggs_kernels::PinholeCamera;

/// A trained model: draws any view at any time.
pub trait Model: Debug + Send {
    /// The view of `camera` at `time` in [0, 1], `[H, W, 4]` on the model's device: colour over [`Model::background`]
    /// and alpha, both in [0, 1] or slightly beyond; alpha is 1 everywhere if the method does not provide it. Without
    /// gradients. A view too large for the device to process at once is drawn in parts.
    fn image(&self, camera: PinholeCamera, time: f32) -> Tensor<3>;

    /// The same view on the host, row-major.
    fn render(&self, camera: PinholeCamera, time: f32) -> Vec<f32> {
        to_vec(self.image(camera, time))
    }

    /// The device it draws on.
    fn device(&self) -> Device;

    /// The background colour, in training and in rendered images.
    fn background(&self) -> [f32; 3];

    /// Centre and half size of what it shows, scene units: for cameras whose target and distance are not otherwise
    /// given.
    fn place(&self) -> (DVec3, f64) {
        (DVec3::ZERO, 1.0)
    }

    /// Its number of parameters and primitives; its size in bytes is that of its file.
    fn counts(&self) -> Counts;

    /// All parameters by name.
    fn parameters(&self) -> BTreeMap<String, HostTensor>;

    /// Writes one safetensors file with everything that drawing needs (not what only training needs), see
    /// [`super::scene_file::write_tensors`].
    ///
    /// # Errors
    /// If the file cannot be written.
    fn save(&self, path: &Path) -> Result<(), SceneError>;

    /// The Gaussians with their field, for a method whose Gaussians are the same at every time.
    fn scene(&self) -> Option<&Scene> {
        None
    }

    /// Like [`Model::scene`], but consumes the model.
    fn into_scene(self: Box<Self>) -> Option<Scene> {
        None
    }
}

/// The size of a model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Number of trained values that drawing needs.
    pub parameters: usize,
    /// Number of Gaussians; 0 for a method without primitives.
    pub primitives: usize,
}

impl Model for Scene {
    fn image(&self, camera: PinholeCamera, time: f32) -> Tensor<3> {
        self.drawn(camera, time)
    }

    fn device(&self) -> Device {
        self.gaussians.means.val().device()
    }

    fn background(&self) -> [f32; 3] {
        self.spec.background
    }

    fn place(&self) -> (DVec3, f64) {
        (self.spec.centre(), self.spec.half_size.into_iter().fold(f32::MIN_POSITIVE, f32::max).into())
    }

    fn counts(&self) -> Counts {
        Counts { parameters: params::sizes(self).values().sum(), primitives: self.gaussians.count() }
    }

    fn parameters(&self) -> BTreeMap<String, HostTensor> {
        params::collect(self)
    }

    fn save(&self, path: &Path) -> Result<(), SceneError> {
        Scene::save(self, path)
    }

    fn scene(&self) -> Option<&Scene> {
        Some(self)
    }

    fn into_scene(self: Box<Self>) -> Option<Scene> {
        Some(*self)
    }
}
