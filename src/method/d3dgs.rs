//! D3DGS, see [`crate::model::d3dgs`]: VolSegGS's Gaussians and training, with the network of D3DGS instead of the
//! field. Its Gaussians persist over time, so everything that works with VolSegGS works with them.

use super::{Method, Model, Training};
use crate::config::types::{Config, EncoderKind};
use crate::data::Dataset;
use crate::model::{Scene, SceneError, d3dgs};
use crate::train::{TrainError, Trainer};
use burn::tensor::Device;
use std::path::Path;

/// D3DGS. Its settings are the section `[d3dgs]` and, for its Gaussians, the same sections as for VolSegGS.
#[derive(Clone, Copy, Debug)]
pub struct D3dgs;

/// Its name, and that of its section.
pub(super) const NAME: &str = "d3dgs";

impl Method for D3dgs {
    fn has_persistent_gaussians(&self) -> bool {
        true
    }

    fn check(&self, config: &Config) -> Result<(), String> {
        let Some(network) = &config.d3dgs else {
            return Err(format!("method = \"{NAME}\" needs the section [{NAME}]: start with --method {NAME}"));
        };
        d3dgs::check(network)?;
        if config.model.embedding > 0 {
            return Err(format!("model.embedding = {}: only with the method volseggs", config.model.embedding));
        }
        if config.model.encoder != EncoderKind::Factorised {
            return Err("model.encoder: only with the method volseggs; remove the key".to_owned());
        }
        if let Some((key, weight)) = config.loss.of_the_grid() {
            return Err(format!("loss.{key} = {weight}: its network has no grid to regularise; set it to 0"));
        }
        if network.time_noise > 0.0 && network.time_noise_steps == 0 {
            return Err(format!(
                "{NAME}.time_noise = {}: has no effect with {NAME}.time_noise_steps = 0; set one of them",
                network.time_noise
            ));
        }
        if config.loss.fade != 0.0 {
            return Err(format!("loss.fade = {}: its network does not change opacities", config.loss.fade));
        }
        if config.speed.cull_visits > 1 {
            return Err(format!("speed.cull_visits = {}: only with the method volseggs", config.speed.cull_visits));
        }
        Ok(())
    }

    fn steps(&self, config: &Config) -> usize {
        super::VolSegGs.steps(config)
    }

    fn start(&self, config: &Config, dataset: &Dataset, device: &Device) -> Result<Box<dyn Training>, TrainError> {
        Ok(Box::new(Trainer::new(config.clone(), dataset, device)?))
    }

    fn open(&self, path: &Path, device: &Device) -> Result<Box<dyn Model>, SceneError> {
        Ok(Box::new(Scene::load(path, device)?))
    }
}
