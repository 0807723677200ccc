//! ViSNeRF as a [`Method`].

use super::model::{NAME, VisNerf};
use super::training::VisNerfTraining;
use crate::config::types::Config;
use crate::config::types::methods::VisNerfConfig;
use crate::data::Dataset;
use crate::method::{Method, Model, Training, Work};
use crate::model::SceneError;
use crate::train::TrainError;
use burn::tensor::Device;
use std::path::Path;

/// ViSNeRF, see [`super`]. Its settings are the section `[visnerf]`.
#[derive(Clone, Copy, Debug)]
pub struct VisNerfMethod;

fn settings(config: &Config) -> Result<&VisNerfConfig, String> {
    let settings = config.visnerf.as_ref();
    settings.ok_or_else(|| format!("method = \"{NAME}\" needs the section [{NAME}]: start with --method {NAME}"))
}

/// Number of values in the planes, and of weights in the two networks that a sample passes through.
fn sizes(settings: &VisNerfConfig) -> [f64; 2] {
    let width = settings.width as f64;
    let inputs = ((3 + settings.features) * (1 + 2 * settings.octaves)) as f64;
    let ranks = (settings.density_ranks + settings.appearance_ranks) as f64;
    let side = (settings.voxels as f64).cbrt();
    [3.0 * ranks * side * side, 2.0 * width * (inputs + width + 2.0) + ranks * settings.features as f64]
}

impl Method for VisNerfMethod {
    fn check(&self, config: &Config) -> Result<(), String> {
        settings(config)?.check()
    }

    fn steps(&self, config: &Config) -> usize {
        config.visnerf.as_ref().map_or(0, |settings| settings.steps)
    }

    fn work(&self, config: &Config) -> Option<Work> {
        let settings = config.visnerf.as_ref()?;
        let [planes, weights] = sizes(settings);
        // rays cross about half of the box's longest chord, and the number of samples along it grows during training
        let samples = 0.25 * (settings.samples_first + settings.samples_last) as f64;
        let of_picture = 0.5 * 3f64.sqrt() * (settings.voxels as f64).cbrt() / settings.render_step;
        let rays = settings.batch as f64;
        let kept = 8.0 * (settings.width + settings.density_ranks + settings.appearance_ranks) as f64;
        let bytes = 4.0 * (5.0 * planes + rays * samples * kept);
        Some(Work { step: rays * samples * weights, pixel: of_picture * weights, bytes })
    }

    fn start(&self, config: &Config, dataset: &Dataset, device: &Device) -> Result<Box<dyn Training>, TrainError> {
        let settings = settings(config).map_err(TrainError::Config)?;
        Ok(Box::new(VisNerfTraining::new(settings, config, dataset, device)?))
    }

    fn open(&self, path: &Path, device: &Device) -> Result<Box<dyn Model>, SceneError> {
        Ok(Box::new(VisNerf::read(path, device)?))
    }
}
