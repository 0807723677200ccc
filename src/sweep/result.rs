//! The files that a run leaves for tables: a small one for each way of measuring it, and one if it failed.

use super::key::short_hash;
use super::plan::Plan;
use crate::compare::metric::upgrade;
use crate::eval::segments::SegmentOptions;
use crate::files::{RunPaths, read_text, write_atomic};
use crate::program;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
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
pub struct Measured<T> {
    /// Digest of the program that measured, see [`crate::program`]; empty in files of early versions.
    pub build: String,
    /// What was measured.
    pub metrics: T,
}

/// A [`Measured`], or the metrics alone, as early versions wrote them.
#[derive(Deserialize)]
#[serde(untagged)]
enum MeasuredFile<T> {
    Current(Measured<T>),
    Legacy(T),
}

/// `failed.json`: why a run failed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Failure {
    /// The error.
    pub error: String,
    /// The stage that failed: config, device, data, train, eval, segments or process.
    pub stage: String,
}

/// Path of the metrics of the evaluation of run `index`, in its folder.
#[must_use]
pub fn metrics_path(plan: &Plan, index: usize) -> PathBuf {
    metrics_in(plan, index, &plan.run_folder(index))
}

/// Like [`metrics_path`], but in `folder`.
#[must_use]
pub fn metrics_in(plan: &Plan, index: usize, folder: &Path) -> PathBuf {
    // when further metrics are registered, everything is measured again
    let registered: String =
        crate::eval::metric::registered().into_iter().map(|(name, _)| format!(" {name}")).collect();
    let weights = plan.contents.of_lpips(&plan.eval.lpips_weights);
    let text = text_of(&plan.eval) + &registered + measured_on(plan, index) + &weights;
    folder.join(format!("metrics-{}.json", short_hash(&text)))
}

/// Path of the metrics by segment of run `index`, measured as `spec` specifies, in its folder.
#[must_use]
pub fn segments_path(plan: &Plan, index: usize, spec: &SegmentOptions) -> PathBuf {
    segments_in(plan, index, spec, &plan.run_folder(index))
}

fn segments_in(plan: &Plan, index: usize, spec: &SegmentOptions, folder: &Path) -> PathBuf {
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
#[must_use]
pub fn failure_path(folder: &Path) -> PathBuf {
    folder.join("failed.json")
}

fn text_of(value: &impl Serialize) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

/// Reads one of these files; `None` if it is missing or not complete.
#[must_use]
pub fn read<T: DeserializeOwned>(path: &Path) -> Option<T> {
    serde_json::from_str(&read_text(path).ok()?).ok()
}

/// Reads what was measured of a whole run; `None` if the file is missing or not complete.
#[must_use]
pub fn read_metrics(path: &Path) -> Option<Measured<Metrics>> {
    let mut found = read_measured::<Metrics>(path)?;
    upgrade(&mut found.metrics);
    Some(found)
}

/// Reads what was measured of segments, by their name; `None` if the file is missing or not complete.
#[must_use]
pub fn read_segments(path: &Path) -> Option<Measured<BTreeMap<String, Metrics>>> {
    read_measured(path)
}

fn read_measured<T: DeserializeOwned>(path: &Path) -> Option<Measured<T>> {
    Some(match read(path)? {
        MeasuredFile::Current(measured) => measured,
        MeasuredFile::Legacy(metrics) => Measured { build: String::new(), metrics },
    })
}

/// Writes metrics with the program's build.
///
/// # Errors
/// A message that names the file.
pub fn write_measured(path: &Path, metrics: impl Serialize) -> Result<(), String> {
    let build = program::build().map(|build| build.digest.clone()).unwrap_or_default();
    write(path, &Measured { build, metrics })
}

/// Writes one of these files.
///
/// # Errors
/// A message that names the file.
pub fn write(path: &Path, value: &impl Serialize) -> Result<(), String> {
    let json = serde_json::to_vec_pretty(value).map_err(|e| e.to_string())?;
    write_atomic(path, &json).map_err(|e| format!("{}: {e}", path.display()))
}

/// How far a run is, according to its files.
#[derive(Clone, Debug, PartialEq)]
pub enum Progress {
    /// Everything that the plan requests is measured.
    Done,
    /// It failed.
    Failed(Failure),
    /// Something is left to do.
    Open,
}

/// Returns how far run `index` of `plan` is.
#[must_use]
pub fn progress(plan: &Plan, index: usize) -> Progress {
    progress_in(plan, index, &plan.run_folder(index))
}

/// Like [`progress`], but in `folder`.
#[must_use]
pub fn progress_in(plan: &Plan, index: usize, folder: &Path) -> Progress {
    let measured = read_metrics(&metrics_in(plan, index, folder)).is_some();
    let segments = |s| read_segments(&segments_in(plan, index, s, folder)).is_some();
    if measured && plan.runs[index].segments.iter().all(segments) {
        return Progress::Done;
    }
    read(&failure_path(folder)).map_or(Progress::Open, Progress::Failed)
}

/// Returns the last test PSNR in a run's log up to `step`, after the step that it is of.
#[must_use]
pub fn live_psnr(folder: &Path, step: usize) -> Option<(usize, f64)> {
    let text = read_text(&RunPaths(folder).metrics()).ok()?;
    let lines = text.lines().filter_map(|l| serde_json::from_str::<serde_json::Value>(l).ok());
    let scored = lines.filter_map(|l| Some((l["step"].as_u64()? as usize, l["test_psnr"].as_f64()?)));
    scored.take_while(|(s, _)| *s <= step).last()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn legacy_metrics_are_read_with_current_names() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("metrics-00.json");
        std::fs::write(&path, r#"{"fps": 20.5, "model_mb": 1.048576, "psnr": 27.0}"#).unwrap();
        let found = read_metrics(&path).unwrap();
        assert_eq!((found.build.as_str(), found.metrics["psnr"]), ("", 27.0));
        assert_eq!((found.metrics.get("fps"), found.metrics["fps_with_copy"]), (None, 20.5));
        assert!((found.metrics["model_mib"] - 1.0).abs() < 1e-12);
        let now = Metrics::from([("fps".to_owned(), 2.0), ("fps_with_copy".to_owned(), 1.0)]);
        write_measured(&path, &now).unwrap();
        let found = read_metrics(&path).unwrap();
        assert_eq!((found.metrics, found.build.len()), (now, 32));

        // segments whose names are those of fields
        std::fs::write(&path, r#"{"build": {"iou": 80.0}, "metrics": {"iou": 70.0}}"#).unwrap();
        assert_eq!(read_segments(&path).unwrap().metrics["build"]["iou"], 80.0);
        for wrong in ["", "[]", r#"{"psnr": "high"}"#] {
            std::fs::write(&path, wrong).unwrap();
            assert_eq!(read_metrics(&path), None, "{wrong}");
        }
    }
}
