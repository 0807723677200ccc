//! Methods: ways of rendering a time-varying dataset, behind one interface.
//!
//! A [`Method`] starts a [`Training`] from a dataset, or opens the [`Model`] that a training left behind; `method` of
//! the configuration names it. What all methods share is written once, outside: the loop over the steps, logs,
//! checkpoints and their folders, evaluation, signals and pauses ([`crate::train::run`]), guards against NaN
//! ([`crate::train::watch`], the optimiser, `model::scene_file`), locks, records, sweeps and tables.
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
//! 1. A folder here with burn modules (`#[derive(Module)]`); random numbers from [`crate::rng::Rng`] with a separate
//!    `Purpose`, keyed by seed and step, so that a checkpoint needs no generator state.
//! 2. A section of the configuration: a struct in `config/types/methods/` with all settings of the method, and a field
//!    `NAME: Option<...>` of `Config`; `seed`, `[data]` and `[output]` have the same meaning for every method. The
//!    published settings as `configs/methods/NAME.toml` and those for two cores as `configs/methods/NAME-small.toml`,
//!    both in `config::PRESETS`: `volseggs train --method NAME` uses the preset of that name.
//! 3. [`Method`], [`Training`] and [`Model`] for it, and a line in [`BUILT_IN`]; for a method that is one network, a
//!    [`network::Network`] is enough, from which [`network::OneNetwork`] derives all three.
//! 4. Tests: the method can overfit one image; a resumed run is bit-identical to an uninterrupted one.
//!
//! A method outside this crate is registered instead, see [`crate::extend::method`] and `docs/research.md`.

pub mod coordnet;
mod d3dgs;
#[cfg(test)]
mod d3dgs_tests;
mod file;
pub mod fourdgs;
mod ignored;
pub mod insitunet;
mod layers;
mod learner;
pub mod network;
mod pixels;
pub mod sphere;
#[cfg(test)]
mod test_support;
pub mod visnerf;
mod volseggs;

pub use crate::model::{Counts, Model};
pub use crate::train::{Saved, Training};
pub use d3dgs::D3dgs;
pub use fourdgs::FourDgs;
pub use volseggs::VolSegGs;

use crate::config::types::{Config, VOLSEGGS};
use crate::data::Dataset;
use crate::files::RunLock;
use crate::model::SceneError;
use crate::registry::Registry;
use crate::train::observer::Observer;
use crate::train::run::{RunOptions, RunOutcome, Start};
use crate::train::{TrainError, check_config};
use burn::tensor::Device;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// A method. One value serves the whole process: it holds no state of any run.
pub trait Method: Send + Sync {
    /// Whether it yields Gaussians that persist over time, as segments, tracks, edits and exports need. Its models are
    /// then a [`crate::model::Scene`] ([`Model::into_scene`]), and every command works with them; otherwise commands
    /// that need Gaussians refuse.
    fn has_persistent_gaussians(&self) -> bool {
        false
    }

    /// Rejects settings of the method that no training can start with; the shared settings have been checked already.
    ///
    /// # Errors
    /// The first invalid key with its value, and the values allowed.
    fn check(&self, config: &Config) -> Result<(), String>;

    /// Number of steps of the whole training.
    fn steps(&self, config: &Config) -> usize;

    /// The cost, for the estimate of a sweep; `None` if it follows from Gaussians and the two stages, as for VolSegGS.
    fn work(&self, _: &Config) -> Option<Work> {
        None
    }

    /// Starts a training on `device` (without gradients; add `.autodiff()`), after [`Method::check`]. Implementations
    /// must check sizes against [`crate::memory::Budget`] before allocating anything large.
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

/// The cost of a method, for a rough estimate of its duration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Work {
    /// Multiply-adds of a step's forward pass.
    pub step: f64,
    /// Multiply-adds per pixel of a rendered image.
    pub pixel: f64,
    /// Bytes of the parameters with their moments, and of the values that a step keeps.
    pub bytes: f64,
}

/// The built-in methods, by name.
pub const BUILT_IN: &[(&str, &dyn Method)] = &[
    (VOLSEGGS, &VolSegGs),
    (d3dgs::NAME, &D3dgs),
    (fourdgs::NAME, &FourDgs),
    ("coordnet", &network::OneNetwork(coordnet::CoordNet)),
    ("insitunet", &insitunet::InSituNetMethod),
    ("visnerf", &visnerf::VisNerfMethod),
];

/// The methods registered by custom programs.
pub(crate) static METHODS: Registry<dyn Method> = Registry::new("method");

/// A method found by name.
#[derive(Clone)]
pub enum Found {
    /// Built in.
    BuiltIn(&'static dyn Method),
    /// Registered.
    Registered(Arc<dyn Method>),
}

impl std::ops::Deref for Found {
    type Target = dyn Method;

    fn deref(&self) -> &Self::Target {
        match self {
            Self::BuiltIn(method) => *method,
            Self::Registered(method) => &**method,
        }
    }
}

/// Finds the method of that name; a registered one takes precedence over a built-in one.
///
/// # Errors
/// If there is none; the message lists the available ones.
pub fn find(name: &str) -> Result<Found, String> {
    if let Ok(method) = METHODS.get(name) {
        return Ok(Found::Registered(method));
    }
    let built_in = BUILT_IN.iter().find(|(known, _)| *known == name);
    built_in.map(|(_, method)| Found::BuiltIn(*method)).ok_or_else(|| {
        let known: Vec<String> = names();
        format!("there is no method \"{name}\"; available: {}", known.join(", "))
    })
}

/// The names of all methods.
#[must_use]
pub fn names() -> Vec<String> {
    let registered = METHODS.all().into_iter().map(|(name, _)| name);
    let mut names: Vec<String> = BUILT_IN.iter().map(|(name, _)| (*name).to_owned()).chain(registered).collect();
    names.sort();
    names.dedup();
    names
}

/// The method that a configuration names.
///
/// # Errors
/// If there is no method of that name.
pub fn of(config: &Config) -> Result<Found, TrainError> {
    find(&config.method).map_err(|e| TrainError::Config(format!("method: {e}")))
}

/// Rejects a configuration that no training can start with.
///
/// # Errors
/// The first invalid value, with its key.
pub fn check(config: &Config) -> Result<(), TrainError> {
    let method = of(config)?;
    check_config(config)?;
    config.segment.check().map_err(|e| TrainError::Config(e.to_string()))?;
    check_sections(config, &method).map_err(TrainError::Config)?;
    method.check(config).map_err(TrainError::Config)
}

/// As [`check`], for a run that is about to begin: also rejects settings that the method would silently ignore. Runs of
/// earlier versions may hold such settings, and still go on.
///
/// # Errors
/// The first invalid or ignored value, with its key.
pub fn check_new(config: &Config) -> Result<(), TrainError> {
    check(config)?;
    match of(config)? {
        Found::BuiltIn(_) => ignored::check(config).map_err(TrainError::Config),
        // only the method itself knows what it reads
        Found::Registered(_) => Ok(()),
    }
}

/// Rejects sections and settings of methods other than the selected one, which would be silently ignored.
fn check_sections(config: &Config, method: &Found) -> Result<(), String> {
    if let (Found::BuiltIn(_), Some(key)) = (method, config.method_settings.keys().next()) {
        return Err(format!(
            "method_settings.{key}: is read only by methods of custom programs; {} has its own keys (`volseggs config \
             show`)",
            config.method
        ));
    }
    let sections = [
        (d3dgs::NAME, config.d3dgs.is_some()),
        (fourdgs::NAME, config.fourdgs.is_some()),
        ("coordnet", config.coordnet.is_some()),
        ("insitunet", config.insitunet.is_some()),
        ("visnerf", config.visnerf.is_some()),
    ];
    match sections.into_iter().find(|(name, is_there)| *is_there && config.method != *name) {
        Some((name, _)) => {
            Err(format!("[{name}]: belongs to the method {name}; set method = \"{name}\", or remove the section"))
        }
        None => Ok(()),
    }
}

/// Starts a training with the method that the configuration names.
///
/// # Errors
/// If the configuration is inconsistent, or training cannot start with the data.
pub fn start(config: &Config, dataset: &Dataset, device: &Device) -> Result<Box<dyn Training>, TrainError> {
    check(config)?;
    of(config)?.start(config, dataset, device)
}

/// Trains into a folder with the method that the configuration names: [`start`], then [`crate::train::run::run`].
///
/// # Errors
/// As these two.
pub fn train(
    config: &Config,
    dataset: &Dataset,
    device: &Device,
    options: &RunOptions,
    held: Option<&RunLock>,
    stop: &AtomicBool,
    observer: &mut dyn Observer,
) -> Result<RunOutcome, TrainError> {
    if options.start == Start::New {
        check_new(config)?;
    }
    let training = start(config, dataset, device)?;
    crate::train::run::run(config, dataset, training, options, held, stop, observer)
}
