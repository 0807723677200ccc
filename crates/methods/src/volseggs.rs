//! VolSegGS, the paper's and this project's method: Gaussians in a canonical space, and a field of planes, lines and
//! vectors that deforms them.

use super::{Method, Model, Training};
use burn::tensor::Device;
use std::path::Path;
use volseggs_core::config::types::Config;
use volseggs_core::model::{Scene, SceneError};
use volseggs_core::train::{TrainError, Trainer};
use volseggs_volume::data::Dataset;

/// VolSegGS. Its settings are the sections `[init]` to `[speed]`.
#[derive(Clone, Copy, Debug)]
pub struct VolSegGs;

impl Method for VolSegGs {
    fn has_persistent_gaussians(&self) -> bool {
        true
    }

    fn check(&self, config: &Config) -> Result<(), String> {
        // all else in its sections is checked for every method
        if config.stages.joint_steps == 0 && config.loss.fade > 0.0 {
            return Err(format!(
                "loss.fade = {}: acts in the joint stage, which stages.joint_steps = 0 leaves out; set it to 0",
                config.loss.fade
            ));
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fading_penalty_without_a_joint_stage_is_refused() {
        let mut config = Config::default();
        config.loss.fade = 0.1;
        VolSegGs.check(&config).unwrap();
        config.stages.joint_steps = 0;
        let error = VolSegGs.check(&config).unwrap_err();
        assert!(error.contains("loss.fade = 0.1") && error.contains("stages.joint_steps = 0"), "{error}");
    }
}
