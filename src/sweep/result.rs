//! What a run leaves for tables: one small file for each way of measuring it, and one if it failed.

use super::file::EvalSpec;
use super::key::short_hash;
use super::plan::Plan;
use super::spec::SegmentSpec;
use crate::files::{read_text, write_atomic};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Metrics by id.
pub type Metrics = BTreeMap<String, f64>;

/// `failed.json`: why a run ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Failure {
    /// The error.
    pub error: String,
    /// What was being done: train, eval, segments.
    pub stage: String,
}

/// Where `folder` has the metrics of an evaluation.
#[must_use]
pub fn metrics_path(folder: &Path, eval: &EvalSpec) -> PathBuf {
    // with metrics that came later, everything is measured again
    let registered: String = crate::extend::metrics().into_iter().map(|(name, _)| format!(" {name}")).collect();
    folder.join(format!("metrics-{}.json", short_hash(&(text_of(eval) + &registered))))
}

/// Where `folder` has the metrics of a measurement of segments, by segment.
#[must_use]
pub fn segments_path(folder: &Path, eval: &EvalSpec, spec: &SegmentSpec) -> PathBuf {
    // the weights of LPIPS are the evaluation's
    let text = text_of(&eval.lpips_weights) + &text_of(spec);
    folder.join(format!("segments-{}.json", short_hash(&text)))
}

/// Where `folder` says that its run failed.
#[must_use]
pub fn failure_path(folder: &Path) -> PathBuf {
    folder.join("failed.json")
}

fn text_of(value: &impl Serialize) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

/// Reads one of these files; none if it is not there or not whole.
#[must_use]
pub fn read<T: DeserializeOwned>(path: &Path) -> Option<T> {
    serde_json::from_str(&read_text(path).ok()?).ok()
}

/// Writes one of these files.
///
/// # Errors
/// A message that names the file.
pub fn write(path: &Path, value: &impl Serialize) -> Result<(), String> {
    let json = serde_json::to_vec_pretty(value).map_err(|e| e.to_string())?;
    write_atomic(path, &json).map_err(|e| format!("{}: {e}", path.display()))
}

/// How far a run is, by its files.
#[derive(Clone, Debug, PartialEq)]
pub enum Progress {
    /// All that the plan asks of it is measured.
    Done,
    /// It failed.
    Failed(Failure),
    /// Something is left to do.
    Open,
}

/// How far run `index` of `plan` is.
#[must_use]
pub fn progress(plan: &Plan, index: usize) -> Progress {
    let folder = plan.run_folder(index);
    let run = &plan.runs[index];
    let measured = read::<Metrics>(&metrics_path(&folder, &plan.eval)).is_some();
    let segments = |s| read::<BTreeMap<String, Metrics>>(&segments_path(&folder, &plan.eval, s)).is_some();
    if measured && run.segments.iter().all(segments) {
        return Progress::Done;
    }
    read(&failure_path(&folder)).map_or(Progress::Open, Progress::Failed)
}

/// The test PSNR that a run's log has nearest before `step`, and its step.
#[must_use]
pub fn live_psnr(folder: &Path, step: usize) -> Option<(usize, f64)> {
    let text = read_text(&folder.join("metrics.jsonl")).ok()?;
    let lines = text.lines().filter_map(|l| serde_json::from_str::<serde_json::Value>(l).ok());
    let scored = lines.filter_map(|l| Some((l["step"].as_u64()? as usize, l["test_psnr"].as_f64()?)));
    scored.take_while(|(s, _)| *s <= step).last()
}
