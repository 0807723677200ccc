//! ViSNeRF as a [`Method`].

use super::model::VisNerf;
use super::settings::VisNerfConfig;
use super::training::VisNerfTraining;
use crate::{Method, MethodWork, Model, Training, ignored};
use burn::tensor::Device;
use std::path::Path;
use volseggs_core::config::sections::ConfigSection;
use volseggs_core::config::types::Config;
use volseggs_core::model::SceneError;
use volseggs_core::train::TrainError;
use volseggs_volume::data::Dataset;

/// ViSNeRF, see [`super`]. Its settings are the section `[visnerf]`.
#[derive(Clone, Copy, Debug)]
pub struct VisNerfMethod;

/// Number of values in the planes, and of weights in the two networks that a sample passes through.
fn sizes(settings: &VisNerfConfig) -> [f64; 2] {
    let width = settings.width as f64;
    let inputs = ((3 + settings.features) * (1 + 2 * settings.octaves)) as f64;
    let ranks = (settings.density_ranks + settings.appearance_ranks) as f64;
    let side = (settings.voxels as f64).cbrt();
    [3.0 * ranks * side * side, 2.0 * width * (inputs + width + 2.0) + ranks * settings.features as f64]
}

impl Method for VisNerfMethod {
    fn section(&self) -> Option<ConfigSection> {
        Some(ConfigSection::new::<VisNerfConfig>())
    }

    fn presets(&self) -> &'static [(&'static str, &'static str)] {
        &[
            ("visnerf", include_str!("../../../../configs/methods/visnerf.toml")),
            ("visnerf-small", include_str!("../../../../configs/methods/visnerf-small.toml")),
        ]
    }

    fn check_ignored(&self, config: &Config) -> Result<(), String> {
        ignored::without_gaussians(config)
    }

    fn check(&self, config: &Config) -> Result<(), String> {
        config.section::<VisNerfConfig>()?.check()
    }

    fn steps(&self, config: &Config) -> usize {
        config.section::<VisNerfConfig>().map_or(0, |settings| settings.steps)
    }

    fn work(&self, config: &Config) -> Option<MethodWork> {
        let settings = &config.section::<VisNerfConfig>().ok()?;
        let [planes, weights] = sizes(settings);
        // rays cross about half of the box's longest chord, and the number of samples along it grows during training
        let samples = 0.25 * (settings.samples_first + settings.samples_last) as f64;
        let of_picture = 0.5 * 3f64.sqrt() * (settings.voxels as f64).cbrt() / settings.render_step;
        let rays = settings.batch as f64;
        let kept = 8.0 * (settings.width + settings.density_ranks + settings.appearance_ranks) as f64;
        let bytes = 4.0 * (5.0 * planes + rays * samples * kept);
        Some(MethodWork::Network { step: rays * samples * weights, pixel: of_picture * weights, bytes })
    }

    fn start(&self, config: &Config, dataset: &Dataset, device: &Device) -> Result<Box<dyn Training>, TrainError> {
        let settings = &config.section::<VisNerfConfig>().map_err(TrainError::Config)?;
        Ok(Box::new(VisNerfTraining::new(settings, config, dataset, device)?))
    }

    fn open(&self, path: &Path, device: &Device) -> Result<Box<dyn Model>, SceneError> {
        Ok(Box::new(VisNerf::read(path, device)?))
    }
}
