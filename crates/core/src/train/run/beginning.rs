//! How a run begins: its folder, its lock, the checkpoint that it continues from.

use super::{RunContext, RunStart};
use crate::data::Dataset;
use crate::files::{LockDuration, LockError, RunLock, RunPaths};
use crate::log::jsonl::truncate_after;
use crate::shell;
use crate::train::checkpoint::{self, CheckpointError};
use crate::train::resume::ChangedKey;
use crate::train::{TrainError, Training};
use std::path::{Path, PathBuf};

/// Note printed when a run is lengthened.
const LENGTHENED: &str = ": rates and the late DSSIM follow the new length from here on, so the result is not that of a run \
                          of this length from the start";

/// Where a run begins. It is locked for as long as this lives.
#[derive(Debug)]
pub(super) struct Beginning {
    /// Folder of the dataset, from the root of the file system.
    pub(super) dataset_root: PathBuf,
    /// Fingerprint of the dataset.
    pub(super) fingerprint: String,
    /// Whether the run continues from a checkpoint.
    pub(super) is_resumed: bool,
    /// Steps taken before.
    pub(super) steps: usize,
    /// Seconds of training before.
    pub(super) seconds: f64,
    /// Keys that were changed on resuming.
    pub(super) changes: Vec<ChangedKey>,
    /// `None` if the caller holds the lock.
    _lock: Option<RunLock>,
}

impl Beginning {
    /// Creates and locks the folder, and restores the checkpoint to continue from, if any, into `training`.
    ///
    /// # Errors
    /// If no run can be created there, another process writes into it, or there is nothing to resume from.
    pub(super) fn prepare(context: &RunContext<'_>, training: &mut dyn Training) -> Result<Self, TrainError> {
        let (dataset, options) = (context.dataset, context.options);
        let out = &options.out;
        if options.start == RunStart::New {
            check_out(out).map_err(TrainError::Resume)?;
        }
        let dataset_root = root_to_record(dataset)?;
        std::fs::create_dir_all(out).map_err(TrainError::in_file(out))?;
        let lock = match context.lock {
            Some(_) => None,
            None => Some(RunLock::acquire(out, &options.command, LockDuration::Long)?),
        };
        let fingerprint = dataset.fingerprint();
        let (steps, seconds, changes) = (training.steps_done(), 0.0, Vec::new());
        let mut new = Self { dataset_root, fingerprint, is_resumed: false, steps, seconds, changes, _lock: lock };
        if let Some(checkpoint) = checkpoint_to_start_from(out, &options.start).map_err(TrainError::Resume)? {
            new.resume(out, &checkpoint, training, &options.config_toml)?;
        }
        Ok(new)
    }

    /// Continues from a checkpoint of `run`: what comes after it is dropped from the metrics and set aside.
    fn resume(
        &mut self,
        run: &Path,
        checkpoint: &Path,
        training: &mut dyn Training,
        config_toml: &str,
    ) -> Result<(), TrainError> {
        let restored = checkpoint::restore(checkpoint, training, config_toml, &self.fingerprint);
        let (state, changes) = restored.map_err(TrainError::Resume)?;
        (self.is_resumed, self.steps) = (true, training.steps_done());
        (self.seconds, self.changes) = (state.seconds, changes);
        truncate_after(&RunPaths(run).metrics(), self.steps as u64)?;
        let aside = checkpoint::set_newer_aside(run, state.step).map_err(TrainError::Resume)?;
        if aside > 0 {
            errln!("note: {aside} newer checkpoints are kept as {}/checkpoints/aside-step-*", run.display());
        }
        for change in &self.changes {
            errln!("note: {change}{}", if change.key.starts_with("stages.") { LENGTHENED } else { "" });
        }
        Ok(())
    }
}

/// Locks the run in `out` for training, if it exists. Called before data are read, so that a run in use is refused at
/// once.
///
/// # Errors
/// If another process writes into the run.
pub fn lock_existing(out: &Path, command: &str) -> Result<Option<RunLock>, LockError> {
    // only where a run exists: no lock file is left in a folder that is then refused
    RunPaths(out).record().is_file().then(|| RunLock::acquire(out, command, LockDuration::Long)).transpose()
}

/// Returns the checkpoint to start from, if any.
fn checkpoint_to_start_from(out: &Path, start: &RunStart) -> Result<Option<PathBuf>, CheckpointError> {
    match (start, checkpoint::newest(out)) {
        (RunStart::ResumeFrom(path), _) => Ok(Some(path.clone())),
        (_, Err(error)) => Err(error),
        (RunStart::Resume, Ok(None)) => Err(CheckpointError::None { run: out.into() }),
        (RunStart::New, Ok(Some(_))) => {
            let reason = format!(
                "holds checkpoints of a run; continue with `volseggs train --resume {}`, or choose another --out",
                shell::path(out)
            );
            Err(CheckpointError::File { path: out.into(), reason })
        }
        (RunStart::New | RunStart::Resume | RunStart::NewOrResume, Ok(newest)) => Ok(newest),
    }
}

/// Returns the folder of the dataset as the run's record names it.
fn root_to_record(dataset: &Dataset) -> Result<PathBuf, TrainError> {
    let root = std::fs::canonicalize(&dataset.root).unwrap_or_else(|_| dataset.root.clone());
    if root.to_str().is_none() {
        let text = format!("{}: the path is not UTF-8, so it cannot be recorded; rename the folder", root.display());
        return Err(TrainError::Config(text));
    }
    Ok(root)
}

/// Refuses a path where no run can be created: a file, a dataset, or a folder that is not a run but holds files with
/// the names that a run writes. Called before anything is written.
fn check_out(out: &Path) -> Result<(), CheckpointError> {
    let refuse = |path: PathBuf, reason: &str| Err(CheckpointError::File { path, reason: reason.to_owned() });
    if let Some(file) = out.ancestors().find(|p| p.symlink_metadata().is_ok() && !p.is_dir()) {
        return refuse(file.to_owned(), "is not a folder, so no run can be created there; choose another --out");
    }
    if RunPaths(out).record().exists() {
        return Ok(());
    }
    if out.join("transforms_train.json").exists() {
        return refuse(out.to_owned(), "is a dataset; choose another --out for the run");
    }
    let paths = RunPaths(out);
    let parts = [paths.config(), paths.metrics(), paths.checkpoints(), paths.tensorboard()];
    match parts.into_iter().find(|part| part.exists()) {
        Some(part) => {
            let reason = "exists without a run.json beside it, so it belongs to no run and is not replaced; \
                          choose another --out";
            refuse(part, reason)
        }
        None => Ok(()),
    }
}
