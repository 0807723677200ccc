//! A trained generator, and its inputs for a view.

use super::generator::{GROUPS, Generator, image_values, parameters};
use super::layers::STATISTICS;
use super::resize::resized;
use crate::file;
use crate::insitunet::InSituNetConfig;
use crate::learner::plain;
use crate::sphere::ViewSphere;
use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;
use std::path::Path;
use volseggs_base::memory::MemoryBudget;
use volseggs_base::rng::{Purpose, Rng};
use volseggs_core::model::params::{self, HostTensor};
use volseggs_core::model::{Counts, Model, SceneError};
use volseggs_kernels::PinholeCamera;

/// The name of the method, of its configuration section and of the header entry in its file.
pub(super) const NAME: &str = "insitunet";
/// Number of inputs for a view.
pub(super) const INPUTS: usize = 4;

/// What the tensors do not determine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InSituNetSpec {
    /// Settings.
    pub config: InSituNetConfig,
    /// The sphere of the training cameras.
    pub sphere: ViewSphere,
    /// Background colour of the training images.
    pub background: [f32; 3],
}

impl InSituNetSpec {
    /// The inputs of a view: the time in [-1, 1]; cosine and sine of the azimuth; and the elevation in quarter turns.
    pub fn inputs(&self, camera: &PinholeCamera, time: f32) -> [f32; INPUTS] {
        let angles = self.sphere.angles(camera);
        let (sine, cosine) = angles.azimuth.sin_cos();
        [2.0 * time - 1.0, cosine as f32, sine as f32, (1.0 - angles.polar / FRAC_PI_2) as f32]
    }
}

/// A generator with the meaning of its inputs.
#[derive(Module, Debug)]
pub struct InSituNet {
    /// The generator.
    pub generator: Generator,
    /// Everything else.
    #[module(skip)]
    pub spec: InSituNetSpec,
}

impl InSituNet {
    /// A generator with random weights.
    pub fn new(spec: InSituNetSpec, seed: u64, device: &Device) -> Self {
        let mut rng = Rng::new(seed, 0, Purpose::MethodInit);
        Self { generator: Generator::new(&spec.config, &GROUPS, &mut rng, device), spec }
    }

    /// Opens the file of a model.
    ///
    /// # Errors
    /// If the file is missing or damaged, holds a NaN or an infinity, or belongs to another method.
    pub fn read(path: &Path, device: &Device) -> Result<Self, SceneError> {
        let file = file::read::<InSituNetSpec>(path, NAME)?;
        file.spec
            .config
            .check()
            .and_then(|()| file.spec.sphere.check())
            .map_err(|e| file::wrong(path, format!("header: {e}")))?;
        let [trained, statistics] = parameters(&file.spec.config, &GROUPS);
        file.check_size(path, trained.saturating_add(statistics))?;
        // with few channels, a small file can make a large image
        let picture = image_values(&file.spec.config).saturating_mul(4 * 4);
        let what = format!("a picture of {0}x{0}", file.spec.config.side());
        MemoryBudget::now().check(what, picture).map_err(|e| file::wrong(path, e.to_string()))?;
        file.fill(path, Self::new(file.spec.clone(), 0, device))
    }
}

impl Model for InSituNet {
    /// The generator's image, resized to that of the camera; what a pixel shows depends only on its relative position.
    /// Alpha is 1, as the generator outputs only colours.
    fn image(&self, camera: PinholeCamera, time: f32) -> Tensor<3> {
        let (generator, device) = plain(&self.generator);
        let inputs = TensorData::new(self.spec.inputs(&camera, time).to_vec(), [1, INPUTS]);
        let picture = generator.forward(Tensor::from_data(inputs, &device), None);
        let (height, width) = (camera.height, camera.width);
        let picture = resized(picture, [height, width]).add_scalar(1.0).mul_scalar(0.5);
        let colours: Tensor<3> = picture.reshape([3, height * width]).transpose().reshape([height, width, 3]);
        Tensor::cat(vec![colours, Tensor::ones([height, width, 1], &device)], 2)
    }

    fn device(&self) -> Device {
        self.generator.device()
    }

    fn background(&self) -> [f32; 3] {
        self.spec.background
    }

    fn place(&self) -> (DVec3, f64) {
        (self.spec.sphere.centre, self.spec.sphere.half_size)
    }

    fn counts(&self) -> Counts {
        let sizes = params::sizes(self);
        let is_trained = |name: &str| !STATISTICS.iter().any(|end| name.ends_with(end));
        Counts { parameters: sizes.iter().filter(|(name, _)| is_trained(name)).map(|(_, n)| n).sum(), primitives: 0 }
    }

    fn parameters(&self) -> BTreeMap<String, HostTensor> {
        params::collect(self)
    }

    fn save(&self, path: &Path) -> Result<(), SceneError> {
        file::save(path, NAME, &params::collect(self), &self.spec)
    }
}
