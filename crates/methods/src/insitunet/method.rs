//! InSituNet as a [`Method`].

use super::generator::{GROUPS, image_values, parameters};
use super::model::InSituNet;
use super::settings::InSituNetConfig;
use super::training::InSituNetTraining;
use crate::{Method, MethodWork, Model, Training, ignored};
use burn::tensor::Device;
use std::path::Path;
use volseggs_core::config::sections::ConfigSection;
use volseggs_core::config::types::Config;
use volseggs_core::model::SceneError;
use volseggs_core::train::TrainError;
use volseggs_volume::data::Dataset;

/// InSituNet, see [`super`]. Its settings are the section `[insitunet]`.
#[derive(Clone, Copy, Debug)]
pub struct InSituNetMethod;

impl Method for InSituNetMethod {
    fn section(&self) -> Option<ConfigSection> {
        Some(ConfigSection::new::<InSituNetConfig>())
    }

    fn presets(&self) -> &'static [(&'static str, &'static str)] {
        &[
            ("insitunet", include_str!("../../../../configs/methods/insitunet.toml")),
            ("insitunet-small", include_str!("../../../../configs/methods/insitunet-small.toml")),
        ]
    }

    fn check_ignored(&self, config: &Config) -> Result<(), String> {
        ignored::without_gaussians(config)
    }

    fn check(&self, config: &Config) -> Result<(), String> {
        config.section::<InSituNetConfig>()?.check()
    }

    fn steps(&self, config: &Config) -> usize {
        config.section::<InSituNetConfig>().map_or(0, |settings| settings.steps)
    }

    fn work(&self, config: &Config) -> Option<MethodWork> {
        let settings = &config.section::<InSituNetConfig>().ok()?;
        let of_pictures = |channels: &[usize]| -> f64 {
            let of = |(k, pair): (usize, &[usize])| {
                let (side, [i, o]) = ((8usize << k) as f64, [pair[0] as f64, pair[1] as f64]);
                side * side * (9.0 * (i + o) * o + i * o)
            };
            channels.windows(2).enumerate().map(of).sum()
        };
        let generator = of_pictures(&settings.channels);
        // generated and real images, and the generated ones again for the generator
        let critic = match settings.adversarial > 0.0 {
            true => 3.0 * of_pictures(&settings.critic_channels.iter().rev().copied().collect::<Vec<_>>()),
            false => 0.0,
        };
        let batch = settings.batch as f64;
        let [trained, statistics] = parameters(settings, &GROUPS);
        let bytes = 20.0 * (trained + statistics) as f64 + 32.0 * batch * image_values(settings) as f64;
        let pixels = (settings.side() * settings.side()) as f64;
        Some(MethodWork::Network { step: batch * (generator + critic), pixel: generator / pixels, bytes })
    }

    fn start(&self, config: &Config, dataset: &Dataset, device: &Device) -> Result<Box<dyn Training>, TrainError> {
        let settings = &config.section::<InSituNetConfig>().map_err(TrainError::Config)?;
        Ok(Box::new(InSituNetTraining::new(settings, config, dataset, device)?))
    }

    fn open(&self, path: &Path, device: &Device) -> Result<Box<dyn Model>, SceneError> {
        Ok(Box::new(InSituNet::read(path, device)?))
    }
}
