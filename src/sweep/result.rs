//! The files that a run leaves for tables: a small one for each way of measuring it, and one if it failed.

use super::key::short_hash;
use super::plan::Plan;
use crate::compare::curves;
use crate::eval::segments::SegmentEvalOptions;
use crate::files::{read_text, write_atomic};
use crate::metrics::METRICS;
use crate::program;
use crate::versioned::{self, VersionedError};
use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::iter;
use std::path::{Path, PathBuf};

/// Metrics by id.
pub type Metrics = BTreeMap<String, f64>;

/// Metrics that only segments have.
pub(super) const OF_SEGMENTS: [&str; 7] =
    ["iou_3d", "iou_3d_least", "iou", "iou_least", "iou_3d_oracle", "iou_oracle", "segment_seconds"];
/// Metrics that a segment and the whole scene have, each its own.
pub(super) const OF_BOTH: [&str; 4] = ["psnr", "ssim", "ssim_gray", "lpips_alex"];
/// Metrics of a run that are the same for all its segments, whose rows show them too.
pub(super) const OF_RUNS: [&str; 7] =
    ["fps", "fps_with_copy", "training_minutes", "model_mib", "model_mb", "gaussians", "peak_memory_gb"];

/// A file of metrics: those of a run, or of its segments by name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredMetrics<T> {
    /// Digest of the program that measured, see [`crate::program`]; empty if unknown.
    pub build: String,
    /// What was measured.
    pub metrics: T,
}

/// `failed.json`: why a run failed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunFailure {
    /// The error.
    pub error: String,
    /// The stage that failed: config, device, data, train, eval, segments or process.
    pub stage: String,
}

/// Path of the metrics of the evaluation of run `index`, in its folder.
pub fn metrics_path(plan: &Plan, index: usize) -> PathBuf {
    metrics_in(plan, index, &plan.run_folder(index))
}

/// Like [`metrics_path`], but in `folder`.
pub fn metrics_in(plan: &Plan, index: usize, folder: &Path) -> PathBuf {
    // when a program adds metrics, everything is measured again
    let added = METRICS.names().into_iter().filter(|name| !METRICS.is_built_in(name));
    let registered: String = added.map(|name| format!(" {name}")).collect();
    let weights = plan.contents.of_lpips(&plan.eval.lpips_weights);
    let text = text_of(&plan.eval) + &registered + measured_on(plan, index) + &weights;
    folder.join(format!("metrics-{}.json", short_hash(&text)))
}

/// Path of the metrics by segment of run `index`, measured as `spec` specifies, in its folder.
pub fn segments_path(plan: &Plan, index: usize, spec: &SegmentEvalOptions) -> PathBuf {
    segments_in(plan, index, spec, &plan.run_folder(index))
}

fn segments_in(plan: &Plan, index: usize, spec: &SegmentEvalOptions, folder: &Path) -> PathBuf {
    // the LPIPS weights are those of the evaluation
    let lpips = &plan.eval.lpips_weights;
    let contents = plan.contents.of_lpips(lpips) + &plan.contents.of_segments(spec);
    let text = text_of(lpips) + &text_of(spec) + measured_on(plan, index) + &contents;
    folder.join(format!("segments-{}.json", short_hash(&text)))
}

/// What the run is measured on: with other test views or another ground truth, everything is measured again.
fn measured_on(plan: &Plan, index: usize) -> &str {
    plan.datasets.get(&plan.runs[index].dataset).map_or("", |data| &data.measured)
}

/// Path of the file in `folder` that says why its run failed.
pub fn failure_path(folder: &Path) -> PathBuf {
    folder.join("failed.json")
}

fn text_of(value: &impl Serialize) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

/// Reads one of these files; `None` if it is missing or not complete.
pub fn read<T: DeserializeOwned>(path: &Path) -> Option<T> {
    versioned::from_json(read_text(path).ok()?).ok()
}

/// Reads what was measured of a whole run; `None` if the file is missing or not complete.
pub fn read_metrics(path: &Path) -> Option<MeasuredMetrics<Metrics>> {
    read(path)
}

/// Reads what was measured of segments, by their name; `None` if the file is missing or not complete.
pub fn read_segments(path: &Path) -> Option<MeasuredMetrics<BTreeMap<String, Metrics>>> {
    read(path)
}

/// Writes metrics with the program's build.
///
/// # Errors
/// A message that names the file.
pub fn write_measured(path: &Path, metrics: impl Serialize) -> Result<(), String> {
    let build = program::build().map(|build| build.digest.clone()).unwrap_or_default();
    write(path, &MeasuredMetrics { build, metrics })
}

/// Writes one of these files.
///
/// # Errors
/// A message that names the file.
pub fn write(path: &Path, value: &impl Serialize) -> Result<(), String> {
    let json = versioned::to_json_pretty(value).map_err(|e| e.to_string())?;
    write_atomic(path, &json).map_err(|e| format!("{}: {e}", path.display()))
}

/// How far a run is, according to its files.
#[derive(Clone, Debug, PartialEq)]
pub enum RunCompletion {
    /// Everything that the plan requests is measured.
    Done,
    /// It failed.
    Failed(RunFailure),
    /// Something is left to do.
    Open,
}

/// Returns why a file is not of this version of the program, if it is not.
fn other_format(path: &Path) -> Option<String> {
    match versioned::from_json::<IgnoredAny>(read_text(path).ok()?) {
        Err(VersionedError::Format(error)) => Some(format!("{}: {error}", path.display())),
        Ok(_) | Err(VersionedError::Json(_)) => None,
    }
}

/// Returns how far run `index` of `plan` is.
pub fn progress(plan: &Plan, index: usize) -> RunCompletion {
    progress_in(plan, index, &plan.run_folder(index))
}

/// Like [`progress`], but in `folder`.
pub fn progress_in(plan: &Plan, index: usize, folder: &Path) -> RunCompletion {
    let metrics = metrics_in(plan, index, folder);
    let segments: Vec<PathBuf> =
        plan.runs[index].segments.iter().map(|s| segments_in(plan, index, s, folder)).collect();
    if let Some(error) = iter::once(&metrics).chain(&segments).find_map(|path| other_format(path)) {
        return RunCompletion::Failed(RunFailure { error, stage: "process".to_owned() });
    }
    if read_metrics(&metrics).is_some() && segments.iter().all(|path| read_segments(path).is_some()) {
        return RunCompletion::Done;
    }
    read(&failure_path(folder)).map_or(RunCompletion::Open, RunCompletion::Failed)
}

/// Returns the last test PSNR in a run's log up to `step`, after the step that it is of.
pub fn live_psnr(folder: &Path, step: usize) -> Option<(usize, f64)> {
    let test = curves::read(folder).test.into_iter().map(|(at, psnr)| (at as usize, psnr));
    test.take_while(|(at, _)| *at <= step).last()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metrics_are_read_as_they_were_written() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("metrics-00.json");
        let now = Metrics::from([("fps".to_owned(), 2.0), ("fps_with_copy".to_owned(), 1.0)]);
        write_measured(&path, &now).unwrap();
        let found = read_metrics(&path).unwrap();
        assert_eq!((found.metrics, found.build.len()), (now, 32));

        // segments whose names are those of fields
        std::fs::write(&path, r#"{"format": 1, "build": "", "metrics": {"build": {"iou": 80.0}}}"#).unwrap();
        assert_eq!(read_segments(&path).unwrap().metrics["build"]["iou"], 80.0);
        assert_eq!(other_format(&path), None);
        std::fs::write(&path, r#"{"format": 2, "build": "", "metrics": {}}"#).unwrap();
        let error = other_format(&path).unwrap();
        assert!(error.contains("metrics-00.json: format: is 2") && read_segments(&path).is_none(), "{error}");
        for wrong in ["", "[]", r#"{"psnr": "high"}"#] {
            std::fs::write(&path, wrong).unwrap();
            assert_eq!(read_metrics(&path), None, "{wrong}");
        }
    }
}
