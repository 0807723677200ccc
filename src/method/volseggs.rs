//! VolSegGS, the paper's and this project's method: Gaussians in a canonical space, and a field of planes, lines and
//! vectors that deforms them.

use super::{Method, Model, Training};
use crate::config::types::Config;
use crate::data::Dataset;
use crate::model::{Scene, SceneError};
use crate::train::{TrainError, Trainer};
use burn::tensor::Device;
use std::path::Path;

/// VolSegGS. Its settings are the sections `[init]` to `[speed]`.
#[derive(Clone, Copy, Debug)]
pub struct VolSegGs;

impl Method for VolSegGs {
    fn has_persistent_gaussians(&self) -> bool {
        true
    }

    fn check(&self, _: &Config) -> Result<(), String> {
        // its sections are checked for every method
        Ok(())
    }

    fn steps(&self, config: &Config) -> usize {
        config.stages.warmup_steps + config.stages.joint_steps
    }

    fn start(&self, config: &Config, dataset: &Dataset, device: &Device) -> Result<Box<dyn Training>, TrainError> {
        Ok(Box::new(Trainer::new(config.clone(), dataset, device)?))
    }

    fn open(&self, path: &Path, device: &Device) -> Result<Box<dyn Model>, SceneError> {
        Ok(Box::new(Scene::load(path, device)?))
    }
}
