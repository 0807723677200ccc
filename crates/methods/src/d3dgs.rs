//! D3DGS, see [`volseggs_core::model::d3dgs`]: VolSegGS's Gaussians and training, with the network of D3DGS instead of the
//! field. Its Gaussians persist over time, so everything that works with VolSegGS works with them.

use super::{GaussianWork, Method, MethodWork, Model, Training, ignored};
use burn::tensor::Device;
use std::path::Path;
use volseggs_core::config::sections::ConfigSection;
use volseggs_core::config::types::{Config, D3dgsConfig};
use volseggs_core::model::{Scene, SceneError, d3dgs};
use volseggs_core::train::{TrainError, Trainer};
use volseggs_volume::data::Dataset;

/// D3DGS. Its settings are the section `[d3dgs]` and, for its Gaussians, the same sections as for VolSegGS.
#[derive(Clone, Copy, Debug)]
pub struct D3dgs;

/// Its name, and that of its section.
pub(super) const NAME: &str = "d3dgs";

impl Method for D3dgs {
    fn section(&self) -> Option<ConfigSection> {
        Some(ConfigSection::new::<D3dgsConfig>())
    }

    fn presets(&self) -> &'static [(&'static str, &'static str)] {
        &[
            ("d3dgs", include_str!("../../../configs/methods/d3dgs.toml")),
            ("d3dgs-small", include_str!("../../../configs/methods/d3dgs-small.toml")),
        ]
    }

    fn check_ignored(&self, config: &Config) -> Result<(), String> {
        ignored::without_field(config)
    }

    fn has_persistent_gaussians(&self) -> bool {
        true
    }

    fn check(&self, config: &Config) -> Result<(), String> {
        let network = config.section::<D3dgsConfig>()?;
        d3dgs::check(&network)?;
        if config.model.embedding > 0 {
            return Err(format!("model.embedding = {}: only with the method volseggs", config.model.embedding));
        }
        if config.model.encoder != "factorised" {
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

    fn work(&self, config: &Config) -> Option<MethodWork> {
        let network = config.section::<D3dgsConfig>().ok()?;
        let (products, kept) = (d3dgs::parameters(&network) as f64, d3dgs::kept_values(&network) as f64);
        Some(MethodWork::Gaussians(GaussianWork { field: 1.0, products, kept, in_warmup: false }))
    }

    fn start(&self, config: &Config, dataset: &Dataset, device: &Device) -> Result<Box<dyn Training>, TrainError> {
        Ok(Box::new(Trainer::new(config.clone(), dataset, device)?))
    }

    fn open(&self, path: &Path, device: &Device) -> Result<Box<dyn Model>, SceneError> {
        Ok(Box::new(Scene::load(path, device)?))
    }
}
