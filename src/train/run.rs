//! A training run in a folder: steps, logs, evaluation on a few test views, checkpoints, signals.

use super::checkpoint::{self, CheckpointError, State};
use super::logs::{line, log_events, message};
use super::observer::{Moment, Observer, wait_for};
pub use super::record::RunRecord;
use super::report::MeanTimes;
use super::resume::{AVERAGE, Change};
use super::{TrainError, Training};
use crate::config::types::Config;
use crate::data::{Dataset, Split, Surroundings};
use crate::files::{LockError, RunLock, RunPaths, Work, read_text, write_atomic};
use crate::log::jsonl::{JsonlWriter, truncate_after};
use crate::log::progress::{self, Lines};
use crate::log::tensorboard::EventWriter;
use crate::memory::peak_memory;
use crate::metrics::psnr::{psnr_of_pictures, to_8_bits};
use crate::model::Model;
use crate::program;
use crate::shell;
use crate::versioned;
use indicatif::ProgressBar;
use std::cell::Cell;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How a run begins.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Start {
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
    pub start: Start,
    /// The command as it was called, reported to others who find the run locked.
    pub command: String,
    /// The resolved configuration as TOML, kept beside the results.
    pub config_toml: String,
    /// The device's name, for the record.
    pub device_name: String,
    /// Stop after this many steps in total, as if interrupted (a checkpoint is saved).
    pub stop_after: Option<usize>,
}

/// How a run ended.
#[derive(Clone, Debug)]
pub struct RunOutcome {
    /// The record as written.
    pub record: RunRecord,
    /// False if it was interrupted.
    pub complete: bool,
    /// PSNR of the last evaluation on test views, decibels.
    pub test_psnr: Option<f64>,
    /// Keys that were changed on resuming.
    pub changed: Vec<Change>,
}

/// Note printed when a run is lengthened.
const LENGTHENED: &str = ": rates and the late DSSIM follow the new length from here on, so the result is not that of a run \
                          of this length from the start";

/// Locks the run in `out` for training, if it exists. Called before data are read, so that a run in use is refused at
/// once.
///
/// # Errors
/// If another process writes into the run.
pub fn lock(out: &Path, command: &str) -> Result<Option<RunLock>, LockError> {
    // only where a run exists: no lock file is left in a folder that is then refused
    RunPaths(out).record().is_file().then(|| RunLock::acquire(out, command, Work::Long)).transpose()
}

/// Returns the checkpoint to start from, if any.
fn beginning(out: &Path, start: &Start) -> Result<Option<PathBuf>, CheckpointError> {
    match (start, checkpoint::newest(out)) {
        (Start::ResumeFrom(path), _) => Ok(Some(path.clone())),
        (_, Err(error)) => Err(error),
        (Start::Resume, Ok(None)) => Err(CheckpointError::None { run: out.into() }),
        (Start::New, Ok(Some(_))) => {
            let reason = format!(
                "holds checkpoints of a run; continue with `volseggs train --resume {}`, or choose another --out",
                shell::path(out)
            );
            Err(CheckpointError::File { path: out.into(), reason })
        }
        (Start::New | Start::Resume | Start::NewOrResume, Ok(newest)) => Ok(newest),
    }
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

/// Drives `training`, newly created from `dataset` with `config`, in `options.out` until the end, a signal or an error;
/// see [`crate::method::train`], which also creates it. `stop` is raised by a signal handler. The run is locked
/// meanwhile; `held` is its lock if the caller has already taken it. `observer` watches between the steps, and may
/// pause the training there; no step depends on it.
///
/// # Errors
/// As [`Training::step`]; also if there is nothing to resume, if another process writes into the run, and if a file
/// cannot be written.
pub fn run(
    config: &Config,
    dataset: &Dataset,
    mut training: Box<dyn Training>,
    options: &RunOptions,
    held: Option<&RunLock>,
    stop: &AtomicBool,
    observer: &mut dyn Observer,
) -> Result<RunOutcome, TrainError> {
    let out = &options.out;
    let log_error =
        |path: &Path, e: &dyn std::fmt::Display| TrainError::Log { path: path.into(), reason: e.to_string() };
    if options.start == Start::New {
        check_out(out).map_err(TrainError::Resume)?;
    }
    let root = std::fs::canonicalize(&dataset.root).unwrap_or_else(|_| dataset.root.clone());
    if root.to_str().is_none() {
        let text = format!("{}: the path is not UTF-8, so it cannot be recorded; rename the folder", root.display());
        return Err(TrainError::Config(text));
    }
    std::fs::create_dir_all(out).map_err(|e| log_error(out, &e))?;
    let _lock = match held {
        Some(_) => None,
        None => Some(RunLock::acquire(out, &options.command, Work::Long)?),
    };
    let fingerprint = dataset.fingerprint();
    let metrics_path = RunPaths(out).metrics();
    let newest = beginning(out, &options.start).map_err(TrainError::Resume)?;
    let (mut seconds_before, mut changed) = (0.0, Vec::new());
    if let Some(path) = &newest {
        let restored = checkpoint::restore(path, &mut *training, &options.config_toml, &fingerprint);
        let (state, changes) = restored.map_err(TrainError::Resume)?;
        (seconds_before, changed) = (state.seconds, changes);
        truncate_after(&metrics_path, training.steps_done() as u64)?;
        let aside = checkpoint::set_newer_aside(out, state.step).map_err(TrainError::Resume)?;
        if aside > 0 {
            errln!("note: {aside} newer checkpoints are kept as {}/checkpoints/aside-step-*", out.display());
        }
    }
    for change in &changed {
        errln!("note: {change}{}", if change.key.starts_with("stages.") { LENGTHENED } else { "" });
    }

    let record_path = RunPaths(out).record();
    let build = program::build().map(|build| build.digest.clone()).unwrap_or_default();
    let earlier = newest.is_some().then(|| earlier_record(&record_path)).flatten();
    let peak_before = earlier.as_ref().map_or(0, |record| record.peak_memory_bytes);
    let earlier_builds = earlier.as_ref().map_or_else(Vec::new, |record| builds_before(record, &build));
    let first = training.steps_done();
    let started = Instant::now();
    let paused = Cell::new(Duration::ZERO);
    let seconds = || seconds_before + (started.elapsed() - paused.get()).as_secs_f64();
    let (centre, _) = training.model().place();
    let mut record = RunRecord {
        version: env!("CARGO_PKG_VERSION").into(),
        method: config.method.clone(),
        build,
        earlier_builds,
        seed: config.seed,
        device: options.device_name.clone(),
        threads: rayon::current_num_threads(),
        dataset: PathBuf::new(),
        dataset_from_run: PathBuf::new(),
        fingerprint: fingerprint.clone(),
        calibration: dataset.calibration(),
        normalisation: dataset.normalisation(),
        surroundings: Surroundings::new(&dataset.first_camera, centre),
        status: "running".into(),
        steps: first,
        training_seconds: seconds_before,
        gaussians: training.model().counts().primitives,
        peak_memory_bytes: peak_before,
    };
    record.set_dataset(out, &root);
    let write_record = |record: &RunRecord| {
        let json = versioned::to_json_pretty(record).map_err(|e| log_error(&record_path, &e))?;
        write_atomic(&record_path, &json).map_err(|e| log_error(&record_path, &e))
    };
    // written before all other files, as it distinguishes a run from any other folder
    write_record(&record)?;
    let config_path = RunPaths(out).config();
    write_atomic(&config_path, options.config_toml.as_bytes()).map_err(|e| log_error(&config_path, &e))?;
    if newest.is_none() && metrics_path.exists() {
        // left by a run that died before its first checkpoint
        std::fs::remove_file(&metrics_path).map_err(|e| log_error(&metrics_path, &e))?;
    }
    let mut metrics = JsonlWriter::open(&metrics_path)?;
    let events_path = RunPaths(out).tensorboard();
    // a run that died before its first checkpoint has left events too
    let events = if first == 0 && !events_path.exists() {
        EventWriter::create(&events_path)
    } else {
        EventWriter::resume(&events_path, first as u64 + 1)
    };
    let mut events = events.map_err(|e| log_error(&events_path, &e))?;

    let save = |training: &dyn Training| -> Result<(), TrainError> {
        let state = State {
            step: training.steps_done(),
            initial: training.first_primitives(),
            dataset: fingerprint.clone(),
            config: options.config_toml.clone(),
            seconds: seconds(),
            packed: false,
        };
        checkpoint::save(out, training, &state, config.output.keep).map_err(TrainError::Save)?;
        Ok(())
    };

    let total = training.total_steps();
    let limit = options.stop_after.map_or(total, |s| s.min(total));
    // created at the first step: an observer may print before it
    let mut bar = None;
    let lines = Lines::new(first, limit);
    let on_terminal = std::io::stderr().is_terminal();
    // without its average the scene is another, even if no step is left
    let dropped = config.optim.average == 0 && changed.iter().any(|change| change.key == AVERAGE);
    let mut saved = newest.is_some() && !dropped;
    let mut test_psnr = None;
    let mut smooth_psnr: Option<f64> = None;
    let (mut report, mut times) = (None, MeanTimes::default());
    // a run resumed after its time is over takes no step; a new one takes one, so that there is a checkpoint
    let out_of_time = |steps: usize| {
        let minutes = config.output.max_minutes;
        minutes > 0.0 && steps > 0 && seconds() >= 60.0 * minutes
    };
    let complete = loop {
        let (model, steps) = (training.model(), training.steps_done());
        let now = Moment { run: out, config, record: &record, model, steps, until: limit, seconds: seconds(), report };
        let waited = wait_for(observer, &now, stop, || match &bar {
            Some(bar) if on_terminal => ProgressBar::set_message(bar, "paused"),
            _ => errln!("paused after {steps} steps"),
        });
        if !waited.is_zero() {
            paused.set(paused.get() + waited);
            bar.iter().for_each(ProgressBar::reset_eta);
        }
        let complete = steps == total || out_of_time(steps);
        if complete || steps >= limit || stop.load(Ordering::Relaxed) {
            break complete;
        }
        let bar = bar.get_or_insert_with(|| progress::step_bar(total, first));
        let report = report.insert(training.step(&dataset.train)?);
        times.add(report.times);
        saved = false;
        let done = report.step + 1;
        smooth_psnr = Some(smooth_psnr.map_or(report.psnr, |p| 0.98 * p + 0.02 * report.psnr));
        let every = |n: usize| n > 0 && (done.is_multiple_of(n) || done == total);
        if every(config.output.eval_every)
            && let Some(test) = &dataset.test
        {
            test_psnr = Some(mean_psnr(training.model(), test, config.output.eval_views));
        }
        if every(config.output.log_every) || every(config.output.eval_every) {
            let evaluated = test_psnr.filter(|_| every(config.output.eval_every));
            let line = line(report, &times.take(), seconds(), evaluated);
            metrics.append(&line)?;
            log_events(&mut events, &line).map_err(|e| log_error(&events_path, &e))?;
        }
        let text = message(report, smooth_psnr, test_psnr);
        let here = seconds() - seconds_before;
        if !on_terminal && (lines.is_due(done, here) || every(config.output.eval_every)) {
            let minutes = config.output.max_minutes;
            let most = if minutes > 0.0 { 60.0 * minutes - seconds() } else { f64::INFINITY };
            errln!("{done}/{total} {:.0} s{} {text}", seconds(), lines.left(done, here, most));
        }
        bar.set_position(done as u64);
        bar.set_message(text);
        if every(config.output.checkpoint_every) {
            save(&*training)?;
            record.steps = done;
            record.training_seconds = seconds();
            record.gaussians = report.primitives;
            write_record(&record)?;
            metrics.sync()?;
            saved = true;
        }
    };
    bar.iter().for_each(ProgressBar::abandon);
    events.flush().map_err(|e| log_error(&events_path, &e))?;
    if !saved && training.steps_done() > 0 {
        save(&*training)?;
        if training.steps_done() == first {
            errln!("note: the scene of step {first} has changed with {AVERAGE}; evaluate it again");
        }
    }
    record.status = if complete { "complete" } else { "interrupted" }.into();
    record.steps = training.steps_done();
    record.training_seconds = seconds();
    record.gaussians = training.model().counts().primitives;
    record.peak_memory_bytes = peak_memory().max(peak_before);
    if let Some(earlier) = earlier.filter(|_| record.steps == first) {
        // nothing was trained: build, device and threads stay those of the steps, which may be fewer than before
        let RunRecord {
            status, dataset, dataset_from_run, calibration, normalisation, surroundings, gaussians, ..
        } = record;
        let (seconds, gaussians) = match earlier.steps == first {
            true => (earlier.training_seconds, earlier.gaussians),
            false => (seconds_before, gaussians),
        };
        record = RunRecord {
            status,
            dataset,
            dataset_from_run,
            calibration,
            normalisation,
            surroundings,
            steps: first,
            training_seconds: seconds,
            gaussians,
            ..earlier
        };
    }
    write_record(&record)?;
    Ok(RunOutcome { record, complete, test_psnr, changed })
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

/// Returns the mean PSNR in decibels over `views` evenly spaced views of a split as 8-bit images; finite, as that of an
/// evaluation.
#[must_use]
pub fn mean_psnr(model: &dyn Model, split: &Split, views: usize) -> f64 {
    let n = split.frames.len();
    let views = views.clamp(1, n);
    let mut truth = vec![0.0; 3 * split.images.width as usize * split.images.height as usize];
    let mut sum = 0.0;
    for k in 0..views {
        let i = k * n / views;
        let frame = &split.frames[i];
        let image = model.render(frame.camera.to_kernel(), frame.time as f32);
        let rgb: Vec<f32> = image.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).map(to_8_bits).collect();
        split.images.composite(i, model.background(), &mut truth);
        truth.iter_mut().for_each(|v| *v = to_8_bits(*v));
        sum += psnr_of_pictures(&rgb, &truth).unwrap_or(f64::NAN);
    }
    sum / views as f64
}
