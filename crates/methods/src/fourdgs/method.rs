//! 4DGS as a method.

use super::model::Scene4d;
use super::settings::FourDgsConfig;
use super::training::FourDgsTraining;
use crate::{GaussianWork, Method, MethodWork, Model, Training, ignored};
use burn::tensor::Device;
use std::path::Path;
use volseggs_core::config::sections::ConfigSection;
use volseggs_core::config::types::{Appearance, Config, ShBands, WarmupTimes};
use volseggs_core::model::SceneError;
use volseggs_core::train::{TrainError, densify};
use volseggs_volume::data::Dataset;

/// 4DGS. Its settings are the section `[4dgs]` and, for what its Gaussians share with those of 3DGS, the same sections
/// as for VolSegGS; the number of steps is `stages.warmup_steps`.
#[derive(Clone, Copy, Debug)]
pub struct FourDgs;

/// Its name, also that of its section.
pub const NAME: &str = "4dgs";

impl Method for FourDgs {
    fn section(&self) -> Option<ConfigSection> {
        Some(ConfigSection::new::<FourDgsConfig>())
    }

    fn presets(&self) -> &'static [(&'static str, &'static str)] {
        &[
            ("4dgs", include_str!("../../../../configs/methods/4dgs.toml")),
            ("4dgs-small", include_str!("../../../../configs/methods/4dgs-small.toml")),
        ]
    }

    fn check_ignored(&self, config: &Config) -> Result<(), String> {
        ignored::without_field(config)
    }

    fn check(&self, config: &Config) -> Result<(), String> {
        let settings = config.section::<FourDgsConfig>()?;
        settings.check()?;
        check_shared(config)?;
        if settings.time_threshold > 0.0 && config.densify.threshold == 0.0 {
            return Err(format!(
                "{NAME}.time_threshold = {}: needs densify.threshold above 0, with which it is combined",
                settings.time_threshold
            ));
        }
        Ok(())
    }

    fn steps(&self, config: &Config) -> usize {
        config.stages.warmup_steps
    }

    fn work(&self, config: &Config) -> Option<MethodWork> {
        let settings = config.section::<FourDgsConfig>().ok()?;
        let kept = settings.kept_values(config.model.sh_degree) as f64;
        // it has no other stage, and its Gaussians cost as much as those with a field
        Some(MethodWork::Gaussians(GaussianWork { field: 1.0, products: 0.0, kept, in_warmup: true }))
    }

    fn start(&self, config: &Config, dataset: &Dataset, device: &Device) -> Result<Box<dyn Training>, TrainError> {
        let settings = config.section::<FourDgsConfig>().map_err(TrainError::Config)?;
        Ok(Box::new(FourDgsTraining::new(config, &settings, dataset, device)?))
    }

    fn open(&self, path: &Path, device: &Device) -> Result<Box<dyn Model>, SceneError> {
        Ok(Box::new(Scene4d::read(path, device)?))
    }
}

/// Rejects settings of the shared sections that would have no effect here.
fn check_shared(config: &Config) -> Result<(), String> {
    let no_stages = "it has one stage, and its steps are stages.warmup_steps";
    let [joint, coarse, visits] = [config.stages.joint_steps, config.speed.coarse_steps, config.speed.cull_visits];
    let average = config.optim.average;
    let prior = config.loss.of_the_grid();
    let refused = [
        (joint > 0, format!("stages.joint_steps = {joint}"), no_stages),
        (
            config.stages.warmup_times != WarmupTimes::All,
            "stages.warmup_times = \"middle\"".to_owned(),
            "its Gaussians cover all times; set it to \"all\"",
        ),
        (
            config.model.appearance != Appearance::Sh,
            "model.appearance = \"headlight\"".to_owned(),
            "its Gaussians have no normals; set it to \"sh\"",
        ),
        (
            config.model.sh_bands != ShBands::All,
            "model.sh_bands = \"even\"".to_owned(),
            "its harmonics of direction and time have all bands; remove the key",
        ),
        (
            config.model.encoder != "factorised",
            "model.encoder".to_owned(),
            "it has no field, so no encoder; remove the key",
        ),
        (
            !config.model.deform_opacity,
            "model.deform_opacity = false".to_owned(),
            "its Gaussians always fade by their own times; remove the key",
        ),
        (
            config.model.embedding > 0,
            format!("model.embedding = {}", config.model.embedding),
            "it has no decoder to read it",
        ),
        (
            config.model.path_opacity != 0.0,
            format!("model.path_opacity = {}", config.model.path_opacity),
            "its Gaussians have no axes in space alone; set it to 0",
        ),
        (
            prior.is_some(),
            prior.map(|(key, weight)| format!("loss.{key} = {weight}")).unwrap_or_default(),
            "it has no grid to regularise; set it to 0",
        ),
        (
            config.loss.fade != 0.0,
            format!("loss.fade = {}", config.loss.fade),
            "its Gaussians fade by their own times; no field changes their opacity",
        ),
        (
            densify::rule_of(config).shares_opacity(),
            format!("densify.mode = \"{}\"", config.densify.mode),
            "how copies would share an opacity that varies over time is not known",
        ),
        (average > 0, format!("optim.average = {average}"), "not with this method"),
        (coarse > 0, format!("speed.coarse_steps = {coarse}"), "not with this method"),
        (visits > 1, format!("speed.cull_visits = {visits}"), "not with this method"),
        (
            config.loss.extra.values().any(|weight| *weight != 0.0),
            "loss.extra".to_owned(),
            "registered terms need Gaussians that persist over time",
        ),
    ];
    match refused.into_iter().find(|(is_set, ..)| *is_set) {
        Some((_, key, why)) => Err(format!("{key}, with the method {NAME}: {why}")),
        None => Ok(()),
    }
}
