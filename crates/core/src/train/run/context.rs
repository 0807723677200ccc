//! What a run is called with.

use crate::config::types::Config;
use crate::data::Dataset;
use crate::files::RunLock;
use crate::train::observer::Observer;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

/// The flag of a run that nothing stops early.
static NEVER: AtomicBool = AtomicBool::new(false);

/// How a run begins.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RunStart {
    /// From the first step; a folder that holds checkpoints is refused.
    New,
    /// From the newest checkpoint; a folder without one is refused.
    Resume,
    /// From this checkpoint of the run; newer ones are set aside once it has been read.
    ResumeFrom(PathBuf),
    /// From the newest checkpoint if there is one, otherwise from the first step.
    NewOrResume,
}

/// Options of a run.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// Folder of the run.
    pub out: PathBuf,
    /// From the first step or from a checkpoint.
    pub start: RunStart,
    /// The command as it was called, reported to others who find the run locked.
    pub command: String,
    /// The resolved configuration as TOML, kept beside the results.
    pub config_toml: String,
    /// The device's name, for the record.
    pub device_name: String,
    /// Stop after this many steps in total, as if interrupted (a checkpoint is saved).
    pub stop_after: Option<usize>,
}

/// What a run trains on and where, who may stop it and who watches.
pub struct RunContext<'a> {
    /// The configuration; the same as `options.config_toml`.
    pub config: &'a Config,
    /// The training views, and the test views if they are evaluated during training.
    pub dataset: &'a Dataset,
    /// Folder, beginning and end.
    pub options: &'a RunOptions,
    /// The run's lock, if the caller holds it already; otherwise it is taken.
    pub lock: Option<&'a RunLock>,
    /// Raised, by a signal handler for instance, to stop after the step in progress, with a checkpoint.
    pub stop: &'a AtomicBool,
    /// Watches between the steps, and may pause the training there; no step depends on it.
    pub observer: Option<&'a mut dyn Observer>,
}

impl<'a> RunContext<'a> {
    /// Returns the context of a run whose lock is free, which nothing stops early and nobody watches.
    pub fn new(config: &'a Config, dataset: &'a Dataset, options: &'a RunOptions) -> Self {
        Self { config, dataset, options, lock: None, stop: &NEVER, observer: None }
    }

    /// Returns the context with `observer` in place of any other.
    pub fn observed_by<'b>(self, observer: &'b mut dyn Observer) -> RunContext<'b>
    where
        'a: 'b,
    {
        let Self { config, dataset, options, lock, stop, .. } = self;
        RunContext { config, dataset, options, lock, stop, observer: Some(observer) }
    }
}
