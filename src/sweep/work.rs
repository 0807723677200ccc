//! One run of a plan from beginning to end: train, measure, measure segments. The same for a process on this machine
//! and for a task of Slurm; what is done is not repeated, and what was begun is resumed.

use super::claim::{ClaimOutcome, claim};
use super::plan::{Plan, PlannedRun};
use super::result::{
    Metrics, RunCompletion, RunFailure, failure_path, metrics_path, progress, read, read_metrics, read_segments,
    segments_path, write, write_measured,
};
use crate::config::types::Config;
use crate::data::{SplitName, Truth};
use crate::device::DeviceName;
use crate::eval::segments::{self, SegmentEvalOptions};
use crate::files::{AtomicDir, LockDuration, LockError, RunLock, RunPaths};
use crate::metrics::lpips::Lpips;
use crate::metrics::metric::Networks;
use crate::run::measure::{MeasuredOn, measure};
use crate::run::{AnyRun, OpenRun};
use crate::train::run::{RunContext, RunOptions, RunRecord, RunStart};
use crate::train::{checkpoint, open_dataset, open_measured};
use burn::tensor::Device;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// How work on a run ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RunEnd {
    /// Everything that the plan requests is done.
    Done,
    /// It was done before.
    AlreadyDone,
    /// Another running process, which is named, has it.
    Held(String),
    /// Another command, which is named, is using it; it should be tried again.
    Busy(String),
    /// It stopped at the requested step, with a checkpoint.
    Paused,
    /// A signal stopped it, with a checkpoint.
    Interrupted,
    /// It failed with this error, which is recorded in its folder.
    Failed(String),
}

/// Takes run `index` of `plan` as far as possible; training pauses after `stop_after` steps, if given.
///
/// # Errors
/// If the run's folder cannot be used. A failure of the run itself is not an error but [`RunEnd::Failed`].
pub fn work(plan: &Plan, index: usize, stop_after: Option<usize>, stop: &AtomicBool) -> std::io::Result<RunEnd> {
    let folder = plan.run_folder(index);
    if let Some(ended) = ended(plan, index) {
        return Ok(ended);
    }
    let held = match claim(&folder)? {
        ClaimOutcome::Mine(claim) => claim,
        ClaimOutcome::Held(holder) => return Ok(RunEnd::Held(holder.to_string())),
    };
    // it may have ended while we asked
    if let Some(ended) = ended(plan, index) {
        return Ok(ended);
    }
    // the claim keeps other sweeps away, also on other machines; the lock keeps away commands that a user runs
    let lock = match RunLock::acquire(&folder, COMMAND, LockDuration::Long) {
        Ok(lock) => lock,
        Err(LockError::Held { holder, .. }) => return Ok(RunEnd::Busy(holder.to_string())),
        Err(LockError::Io { source, .. } | LockError::ReadOnly { source, .. }) => return Err(source),
    };
    let ended =
        match (Worker { plan, index, run: &plan.runs[index], folder: &folder, stop, lock: &lock }).go(stop_after) {
            Ok(ended) => ended,
            Err(_) if stop.load(Ordering::Relaxed) => RunEnd::Interrupted,
            Err(failure) => {
                write(&failure_path(&folder), &failure).map_err(std::io::Error::other)?;
                RunEnd::Failed(format!("{}: {}", failure.stage, failure.error))
            }
        };
    drop((lock, held));
    Ok(ended)
}

/// How a run ended before: done, or failed; a failed run is tried again only on request (its record is then removed).
fn ended(plan: &Plan, index: usize) -> Option<RunEnd> {
    match progress(plan, index) {
        RunCompletion::Done => Some(RunEnd::AlreadyDone),
        RunCompletion::Failed(failure) => Some(RunEnd::Failed(format!("{}: {}", failure.stage, failure.error))),
        RunCompletion::Open => None,
    }
}

struct Worker<'a> {
    plan: &'a Plan,
    index: usize,
    run: &'a PlannedRun,
    folder: &'a Path,
    stop: &'a AtomicBool,
    lock: &'a RunLock,
}

/// The command that is named to others while this process holds the run.
const COMMAND: &str = "volseggs sweep";

fn failed<E: std::fmt::Display>(stage: &'static str) -> impl Fn(E) -> RunFailure {
    move |e| RunFailure { error: e.to_string(), stage: stage.to_owned() }
}

impl Worker<'_> {
    fn go(&self, stop_after: Option<usize>) -> Result<RunEnd, RunFailure> {
        let config: Config = toml::from_str(&self.run.config).map_err(failed("config"))?;
        let device: DeviceName = self.run.device.parse().map_err(failed("device"))?;
        let device = device.open().map_err(failed("device"))?;
        let data = self
            .plan
            .datasets
            .get(&self.run.dataset)
            .ok_or("the plan does not contain the dataset")
            .map_err(failed("data"))?;
        if let Some(ended) = self.train(&config, &data.folder, &device, stop_after)? {
            return Ok(ended);
        }
        if self.stop.load(Ordering::Relaxed) {
            return Ok(RunEnd::Interrupted);
        }
        let trained = AnyRun::open_any(self.folder, &device).map_err(failed("eval"))?;
        let networks = Networks::load(&self.plan.eval.lpips_weights, &device).map_err(failed("eval"))?;
        if read_metrics(&metrics_path(self.plan, self.index)).is_none() {
            self.measure(&config, &data.folder, &trained, &networks)?;
        }
        if self.run.segments.is_empty() {
            return Ok(RunEnd::Done);
        }
        let trained = trained.gaussians().map_err(failed("segments"))?;
        for spec in &self.run.segments {
            if self.stop.load(Ordering::Relaxed) {
                return Ok(RunEnd::Interrupted);
            }
            self.segments(spec, config.seed, &data.folder, &trained, networks.lpips())?;
        }
        Ok(RunEnd::Done)
    }

    fn record(&self) -> Result<RunRecord, RunFailure> {
        let path = RunPaths(self.folder).record();
        read(&path).ok_or_else(|| failed("eval")(format!("{}: missing or incomplete", path.display())))
    }

    /// Trains to the end; returns how it ended if it did not get there.
    fn train(
        &self,
        config: &Config,
        data: &Path,
        device: &Device,
        stop_after: Option<usize>,
    ) -> Result<Option<RunEnd>, RunFailure> {
        if let Ok(record) = self.record()
            && record.status == "complete"
            && checkpoint::newest_scene(self.folder).is_some()
        {
            // a time limit may end a run earlier, but only `train --resume` takes it further
            return match record.steps > self.run.steps {
                false => Ok(None),
                true => Err(failed("train")(format!(
                    "{}: was trained on to step {}, the sweep's runs to step {}; move the folder away to train it again",
                    self.folder.display(),
                    record.steps,
                    self.run.steps
                ))),
            };
        }
        let dataset = open_dataset(data, config).map_err(failed("data"))?;
        let options = RunOptions {
            out: self.folder.to_owned(),
            start: RunStart::NewOrResume,
            command: COMMAND.to_owned(),
            config_toml: self.run.config.clone(),
            device_name: self.run.device.clone(),
            stop_after,
        };
        let context =
            RunContext { lock: Some(self.lock), stop: self.stop, ..RunContext::new(config, &dataset, &options) };
        let outcome = crate::method::train(context, device).map_err(failed("train"))?;
        Ok(match outcome.reason.is_complete() {
            true => None,
            false if self.stop.load(Ordering::Relaxed) => Some(RunEnd::Interrupted),
            false => Some(RunEnd::Paused),
        })
    }

    fn measure(&self, config: &Config, data: &Path, trained: &AnyRun, networks: &Networks) -> Result<(), RunFailure> {
        let split = open_measured(data, SplitName::Test, config, self.plan.eval.views, None);
        let split = split.map_err(failed("eval"))?;
        let on = MeasuredOn::open(trained, Some(data), SplitName::Test).map_err(failed("eval"))?;
        let folder = trained.paths().eval().join("test");
        let evaluation = measure(trained, &split, networks, &on, &folder, |_, _| ()).map_err(failed("eval"))?;
        let mut metrics = crate::compare::runs::metrics(&evaluation.summary, &trained.record);
        // non-finite values have no place in JSON or in a table
        metrics.retain(|_, value| value.is_finite());
        write_measured(&metrics_path(self.plan, self.index), &metrics).map_err(failed("eval"))
    }

    fn segments(
        &self,
        spec: &SegmentEvalOptions,
        seed: u64,
        data: &Path,
        trained: &OpenRun,
        networks: &[Lpips],
    ) -> Result<(), RunFailure> {
        let path = segments_path(self.plan, self.index, spec);
        if read_segments(&path).is_some() {
            return Ok(());
        }
        let options = SegmentEvalOptions { seed, ..spec.clone() };
        let truth = Truth::read(data).map_err(failed("segments"))?;
        let widening = trained.widening();
        // never committed: it is removed when this ends, or now if an earlier process was killed
        let work = AtomicDir::create(&self.folder.join("masks")).map_err(failed("segments"))?;
        let (mut evaluation, _) =
            segments::evaluate_segments(&trained.scene, widening, &truth, &options, networks, work.dir(), |what| {
                errln!("{what}")
            })
            .map_err(failed("segments"))?;
        evaluation.data = MeasuredOn::own(trained, Vec::new()).data;
        let name = path.file_stem().unwrap_or_default();
        segments::write_results(&trained.paths().eval().join(name), &evaluation).map_err(failed("segments"))?;
        let mut by_segment: BTreeMap<String, Metrics> = BTreeMap::new();
        for result in &evaluation.results {
            let mut metrics = Metrics::new();
            let mut put = |name: &str, value: Option<f64>| {
                metrics.extend(value.map(|v| (name.to_owned(), v)));
            };
            let (fixed, row) = (&result.fixed, result.fixed.at.as_ref());
            put("iou_3d", fixed.iou_3d);
            put("iou_3d_least", fixed.least_iou_3d);
            put("iou", fixed.iou());
            put("iou_least", fixed.least_iou);
            put("psnr", row.and_then(|r| r.psnr));
            put("ssim", row.and_then(|r| r.ssim));
            put("ssim_gray", row.and_then(|r| r.ssim_gray));
            put("lpips_alex", row.and_then(|r| r.lpips));
            put("iou_3d_oracle", result.oracle.as_ref().and_then(|o| o.iou_3d));
            put("iou_oracle", result.oracle.as_ref().and_then(|o| o.iou()));
            metrics.extend(
                evaluation.training_seconds.get(result.method.name()).map(|s| ("segment_seconds".to_owned(), *s)),
            );
            metrics.retain(|_, value| value.is_finite());
            by_segment.insert(result.segment.clone(), metrics);
        }
        write_measured(&path, &by_segment).map_err(failed("segments"))
    }
}
