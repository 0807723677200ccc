//! Methods: ways of rendering a time-varying dataset, behind one interface.
//!
//! A [`Method`] starts a [`Training`] from a dataset, or opens the [`Model`] that a training left behind; `method` of
//! the configuration names it. What all methods share is written once, outside: the loop over the steps, logs,
//! checkpoints and their folders, evaluation, signals and pauses ([`volseggs_core::train::run`]), guards against NaN
//! ([`volseggs_core::train::watch`], the optimiser, `model::scene_file`), locks, records, sweeps and tables.
//!
//! | Trait | Meaning | Lifetime |
//! |---|---|---|
//! | [`Method`] | the method itself: what it can do, how it starts | the whole process, found by its name ([`find`]) |
//! | [`Training`] | a training in progress: parameters, moments, the step | in memory, during training |
//! | [`Model`] | what was trained, with exactly what drawing needs | in memory, from and to `scene.safetensors` |
//!
//! No trait has a type parameter: burn's tensors and devices carry their backend at run time, so a run opened from disk
//! is a `Box<dyn Model>` regardless of its method.
//!
//! # Adding a method
//!
//! 1. A folder here with burn modules (`#[derive(Module)]`); random numbers from [`volseggs_base::rng::Rng`] with a separate
//!    `Purpose`, keyed by seed and step, so that a checkpoint needs no generator state.
//! 2. A section of the configuration: a struct with all settings of the method, which implements
//!    [`Settings`](volseggs_core::config::sections::Settings); `seed`, `[data]` and `[output]` have the same meaning for every
//!    method. The published settings as `configs/methods/NAME.toml` and those for two cores as
//!    `configs/methods/NAME-small.toml`: `volseggs train --method NAME` uses the preset of that name.
//! 3. [`Method`], [`Training`] and [`Model`] for it, and a line in `METHODS`; for a method that is one network, a
//!    [`network::Network`] gives the last two.
//! 4. Tests: the method can overfit one image; a resumed run is bit-identical to an uninterrupted one.
//!
//! A method outside this crate is registered instead, see `volseggs::extend::method` and `docs/research.md`.

#[macro_use]
extern crate volseggs_base;

pub mod coordnet;
mod d3dgs;
#[cfg(test)]
mod d3dgs_tests;
mod file;
pub mod fourdgs;
pub mod ignored;
pub mod insitunet;
mod layers;
mod learner;
pub mod network;
mod pixels;
#[cfg(test)]
mod presets_tests;
mod ranges;
pub mod sphere;
#[cfg(test)]
mod test_support;
pub mod visnerf;
mod volseggs;
mod work;

pub use d3dgs::D3dgs;
pub use fourdgs::FourDgs;
pub use volseggs::VolSegGs;
pub use volseggs_core::model::{Counts, Model};
pub use volseggs_core::train::{SavedTraining, Training};
pub use work::{GaussianWork, MethodWork};

use burn::tensor::Device;
use std::path::Path;
use volseggs_base::registry::Registry;
use volseggs_core::config::PRESETS;
use volseggs_core::config::layers::{ConfigError, Layers};
use volseggs_core::config::sections::ConfigSection;
use volseggs_core::config::types::{Config, VOLSEGGS};
use volseggs_core::model::SceneError;
use volseggs_core::train::run::{RunContext, RunOutcome};
use volseggs_core::train::{TrainError, check_config};
use volseggs_volume::data::Dataset;

/// A method. One value serves the whole process: it holds no state of any run.
pub trait Method: Send + Sync {
    /// Whether it yields Gaussians that persist over time, as segments, tracks, edits and exports need. Its models are
    /// then a [`volseggs_core::model::Scene`] ([`Model::into_scene`]), and every command works with them; otherwise commands
    /// that need Gaussians refuse.
    fn has_persistent_gaussians(&self) -> bool {
        false
    }

    /// Its own section of the configuration, if it has one. It is refused for every other method.
    fn section(&self) -> Option<ConfigSection> {
        None
    }

    /// Presets with its settings, as (name, TOML); `volseggs train --method NAME` starts from the one of its name.
    fn presets(&self) -> &'static [(&'static str, &'static str)] {
        &[]
    }

    /// Rejects settings of the shared sections that it does not read: two runs that differ in nothing else would be compared
    /// as if they differed. See [`ignored`].
    ///
    /// # Errors
    /// The first such key with its value, and what to do.
    fn check_ignored(&self, _: &Config) -> Result<(), String> {
        Ok(())
    }

    /// Rejects settings of the method that no training can start with; the shared settings have been checked already.
    ///
    /// # Errors
    /// The first invalid key with its value, and the values allowed.
    fn check(&self, config: &Config) -> Result<(), String>;

    /// Number of steps of the whole training.
    fn steps(&self, config: &Config) -> usize;

    /// The cost, for the estimate of a sweep; `None` if it is that of the Gaussians and the field of the shared sections.
    fn work(&self, _: &Config) -> Option<MethodWork> {
        None
    }

    /// Starts a training on `device` (without gradients; add `.autodiff()`), after [`Method::check`]. Implementations
    /// must check sizes against [`volseggs_base::memory::MemoryBudget`] before allocating anything large.
    ///
    /// # Errors
    /// If training cannot start with the data.
    fn start(&self, config: &Config, dataset: &Dataset, device: &Device) -> Result<Box<dyn Training>, TrainError>;

    /// Opens the file that [`Model::save`] wrote.
    ///
    /// # Errors
    /// If the file is missing or damaged, holds a NaN or an infinity, or belongs to another method.
    fn open(&self, path: &Path, device: &Device) -> Result<Box<dyn Model>, SceneError>;
}

/// All methods, by name.
pub static METHODS: Registry<dyn Method> = Registry::new(
    "method",
    &[
        (VOLSEGGS, &VolSegGs),
        (d3dgs::NAME, &D3dgs),
        (fourdgs::NAME, &FourDgs),
        ("coordnet", &coordnet::CoordNet),
        ("insitunet", &insitunet::InSituNetMethod),
        ("visnerf", &visnerf::VisNerfMethod),
    ],
);

/// Finds the method of that name.
///
/// # Errors
/// If there is none; the message lists those that there are.
pub fn find(name: &str) -> Result<&'static dyn Method, String> {
    METHODS.get(name).map_err(|e| e.to_string())
}

/// The names of all methods: the built-in ones, then the others, sorted.
pub fn names() -> Vec<String> {
    METHODS.names()
}

/// The built-in presets and those of all methods, as (name, TOML).
pub fn presets() -> Vec<(&'static str, &'static str)> {
    let of_methods = METHODS.all().into_iter().flat_map(|(_, method)| method.presets());
    PRESETS.iter().chain(of_methods).copied().collect()
}

/// Returns the configuration of a built-in preset, of any method.
///
/// # Errors
/// [`ConfigError::NotFound`] if there is no such preset.
pub fn preset(name: &str) -> Result<Config, ConfigError> {
    Ok(layers().source(name).resolve()?.value)
}

/// Layers of configurations that know the presets and the sections of all methods.
pub fn layers() -> Layers<'static> {
    add_sections();
    Layers::with_presets(presets())
}

/// Makes configurations accept the sections of all methods.
pub fn add_sections() {
    METHODS.all().into_iter().filter_map(|(_, method)| method.section()).for_each(ConfigSection::add);
}

/// The method that a configuration names.
///
/// # Errors
/// If there is no method of that name.
pub fn named_in(config: &Config) -> Result<&'static dyn Method, TrainError> {
    find(&config.method).map_err(|e| TrainError::Config(format!("method: {e}")))
}

/// Rejects a configuration that no training can start with, or in which the method would silently ignore a setting.
///
/// # Errors
/// The first invalid or ignored value, with its key.
pub fn check(config: &Config) -> Result<(), TrainError> {
    let method = named_in(config)?;
    check_config(config)?;
    config.segment.check().map_err(|e| TrainError::Config(e.to_string()))?;
    check_sections(config).map_err(TrainError::Config)?;
    method.check(config).map_err(TrainError::Config)?;
    method.check_ignored(config).map_err(TrainError::Config)
}

/// Rejects sections and settings of methods other than the selected one, which would be silently ignored.
fn check_sections(config: &Config) -> Result<(), String> {
    if let (true, Some(key)) = (METHODS.is_built_in(&config.method), config.method_settings.keys().next()) {
        return Err(format!(
            "method_settings.{key}: is read only by methods of custom programs; {} has its own keys (`volseggs config \
             show`)",
            config.method
        ));
    }
    let own = find(&config.method)?.section().map(ConfigSection::name);
    let Some(other) = config.sections.names().find(|name| own != Some(*name)) else { return Ok(()) };
    let owner = METHODS.all().into_iter().find(|(_, method)| method.section().is_some_and(|s| s.name() == other));
    Err(match owner {
        Some((name, _)) => {
            format!("[{other}]: belongs to the method {name}; set method = \"{name}\", or remove the section")
        }
        None => format!("[{other}]: no method has this section; remove it"),
    })
}

/// Starts a training with the method that the configuration names.
///
/// # Errors
/// If the configuration is inconsistent, or training cannot start with the data.
pub fn start(config: &Config, dataset: &Dataset, device: &Device) -> Result<Box<dyn Training>, TrainError> {
    add_sections();
    check(config)?;
    named_in(config)?.start(config, dataset, device)
}

/// Trains into a folder on `device` with the method that the configuration names: [`start`], then
/// [`volseggs_core::train::run::run`].
///
/// # Errors
/// As these two.
pub fn train(context: RunContext<'_>, device: &Device) -> Result<RunOutcome, TrainError> {
    let training = start(context.config, context.dataset, device)?;
    volseggs_core::train::run::run(context, training)
}
