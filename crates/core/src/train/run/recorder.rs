//! The record of a run while it trains, `run.json`.

use super::beginning::Beginning;
use super::clock::RunClock;
use super::stop::StopReason;
use super::{RunContext, TakenStep};
use crate::data::Surroundings;
use crate::files::{RunPaths, read_text, write_atomic};
use crate::memory::peak_memory;
use crate::program;
use crate::train::record::RunRecord;
use crate::train::{TrainError, Training};
use crate::versioned;
use std::path::{Path, PathBuf};

/// Keeps the record of a run.
#[derive(Debug)]
pub(super) struct RunRecorder {
    path: PathBuf,
    record: RunRecord,
    /// The record that a resumed run had before.
    earlier: Option<RunRecord>,
    /// Steps taken before this process.
    first: usize,
}

impl RunRecorder {
    /// Writes the record of a run that begins at `beginning`, before all its other files, as it distinguishes a run from any
    /// other folder; then the configuration beside it.
    ///
    /// # Errors
    /// If one of the two cannot be written.
    pub(super) fn begin(
        context: &RunContext<'_>,
        beginning: &Beginning,
        training: &dyn Training,
    ) -> Result<Self, TrainError> {
        let RunContext { config, dataset, options, .. } = context;
        let paths = RunPaths(&options.out);
        let build = program::build().map(|build| build.digest.clone()).unwrap_or_default();
        let earlier = beginning.is_resumed.then(|| earlier_record(&paths.record())).flatten();
        let (centre, _) = training.model().place();
        let mut record = RunRecord {
            version: env!("CARGO_PKG_VERSION").into(),
            method: config.method.clone(),
            earlier_builds: earlier.as_ref().map_or_else(Vec::new, |record| builds_before(record, &build)),
            build,
            seed: config.seed,
            device: options.device_name.clone(),
            threads: rayon::current_num_threads(),
            dataset: PathBuf::new(),
            dataset_from_run: PathBuf::new(),
            fingerprint: beginning.fingerprint.clone(),
            calibration: dataset.calibration(),
            normalisation: dataset.normalisation(),
            surroundings: Surroundings::new(&dataset.first_camera, centre),
            status: "running".into(),
            steps: beginning.steps,
            training_seconds: beginning.seconds,
            gaussians: training.model().counts().primitives,
            peak_memory_bytes: earlier.as_ref().map_or(0, |record| record.peak_memory_bytes),
        };
        record.set_dataset(&options.out, &beginning.dataset_root);
        let recorder = Self { path: paths.record(), record, earlier, first: beginning.steps };
        recorder.write()?;
        let config_path = paths.config();
        write_atomic(&config_path, options.config_toml.as_bytes()).map_err(TrainError::in_file(&config_path))?;
        Ok(recorder)
    }

    /// The record as last written.
    pub(super) fn record(&self) -> &RunRecord {
        &self.record
    }

    /// Records a checkpoint that was saved after a step.
    ///
    /// # Errors
    /// If the record cannot be written.
    pub(super) fn after_checkpoint(&mut self, step: &TakenStep<'_>) -> Result<(), TrainError> {
        self.record.steps = step.steps();
        self.record.training_seconds = step.clock.seconds();
        self.record.gaussians = step.report.primitives;
        self.write()
    }

    /// Records the end of the run, and returns the record.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(super) fn finish(
        mut self,
        reason: StopReason,
        training: &dyn Training,
        clock: &RunClock,
    ) -> Result<RunRecord, TrainError> {
        let (steps, gaussians) = (training.steps_done(), training.model().counts().primitives);
        self.record.status = reason.status().into();
        match self.earlier.take() {
            Some(earlier) if steps == self.first => self.keep_training_of(earlier, gaussians),
            _ => {
                self.record.steps = steps;
                self.record.training_seconds = clock.seconds();
                self.record.gaussians = gaussians;
                self.record.peak_memory_bytes = peak_memory().max(self.record.peak_memory_bytes);
            }
        }
        self.write()?;
        Ok(self.record)
    }

    /// Records that this process trained nothing: build, device and threads stay those of the steps, which may be fewer
    /// than `earlier` has, if the run was resumed from an older checkpoint.
    fn keep_training_of(&mut self, earlier: RunRecord, gaussians: usize) {
        let now = std::mem::take(&mut self.record);
        let (training_seconds, gaussians) = match earlier.steps == self.first {
            true => (earlier.training_seconds, earlier.gaussians),
            false => (now.training_seconds, gaussians),
        };
        self.record = RunRecord {
            status: now.status,
            dataset: now.dataset,
            dataset_from_run: now.dataset_from_run,
            calibration: now.calibration,
            normalisation: now.normalisation,
            surroundings: now.surroundings,
            steps: self.first,
            training_seconds,
            gaussians,
            ..earlier
        };
    }

    fn write(&self) -> Result<(), TrainError> {
        let json = versioned::to_json_pretty(&self.record).map_err(TrainError::in_file(&self.path))?;
        write_atomic(&self.path, &json).map_err(TrainError::in_file(&self.path))
    }
}

/// Returns the run's record before it is rewritten; `None` if it cannot be read.
fn earlier_record(path: &Path) -> Option<RunRecord> {
    versioned::from_json(read_text(path).ok()?).ok()
}

/// Returns the builds named in a run's record, except `build`.
fn builds_before(record: &RunRecord, build: &str) -> Vec<String> {
    let mut builds = record.earlier_builds.clone();
    if !builds.contains(&record.build) {
        builds.push(record.build.clone());
    }
    builds.retain(|one| one != build);
    builds
}
