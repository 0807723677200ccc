//! Run folders as outcomes: what `volseggs compare` lays side by side.

use super::results::{Outcome, OutcomeState, ResultSet};
use crate::eval::run::Summary;
use crate::files::read_text;
use crate::train::run::RunRecord;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Metrics by id of an evaluated run.
#[must_use]
pub fn metrics(summary: &Summary, record: &RunRecord) -> BTreeMap<String, f64> {
    let mut metrics = BTreeMap::from([
        ("psnr".to_owned(), summary.psnr),
        ("ssim".to_owned(), summary.ssim),
        ("ssim_gray".to_owned(), summary.ssim_gray),
        ("fps".to_owned(), summary.fps),
        ("training_minutes".to_owned(), summary.training_seconds / 60.0),
        ("model_mb".to_owned(), summary.model_bytes as f64 / 1e6),
        ("gaussians".to_owned(), summary.gaussians as f64),
    ]);
    metrics.extend(summary.lpips_alex.map(|v| ("lpips_alex".to_owned(), v)));
    metrics.extend(summary.lpips_vgg.map(|v| ("lpips_vgg".to_owned(), v)));
    if record.peak_memory_bytes > 0 {
        metrics.insert("peak_memory_gb".to_owned(), record.peak_memory_bytes as f64 / 1e9);
    }
    metrics.extend(summary.extra.clone());
    metrics
}

/// A run that cannot be compared.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}", path.display())]
pub struct RunError {
    path: PathBuf,
    problem: String,
}

/// Run folders, each evaluated by `volseggs eval`, as one set: runs whose configurations differ in the seed alone are
/// one variant, named after the first one's folder. `metrics` are those to report.
///
/// # Errors
/// A folder that is no run, or has not been evaluated on its test views.
pub fn from_folders(folders: &[PathBuf], metrics: &[String]) -> Result<ResultSet, RunError> {
    let mut known: Vec<(Table, String)> = Vec::new();
    let mut datasets: Vec<(String, String)> = Vec::new();
    let mut outcomes: Vec<Outcome> = Vec::new();
    for folder in folders {
        let bad = |problem: String| RunError { path: folder.clone(), problem };
        let record: RunRecord = read(&folder.join("run.json"))
            .map_err(|e| bad(format!("{e}; give folders that `volseggs train --out` made")))?;
        let summary: Summary = read(&folder.join("eval/test/mean.json"))
            .map_err(|e| bad(format!("{e}; run `volseggs eval {}` first", folder.display())))?;
        let text = read_text(&folder.join("config.toml")).map_err(|e| bad(format!("config.toml: {e}")))?;
        let mut config: Table = text.parse().map_err(|e| bad(format!("config.toml: {e}")))?;
        config.remove("seed");
        // datasets of one name are told apart by their whole path
        let short = record.dataset.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let known_data = datasets.iter().find(|(print, _)| *print == record.fingerprint).map(|(_, name)| name.clone());
        let dataset = known_data.unwrap_or_else(|| {
            let taken = datasets.iter().any(|(_, name)| *name == short);
            let name = if taken { record.dataset.display().to_string() } else { short };
            datasets.push((record.fingerprint.clone(), name.clone()));
            name
        });
        // a seed that a variant has already is another row, such as the same configuration from another version
        let clash = |name: &str| {
            let same = |o: &Outcome| o.dataset == dataset && o.device == record.device && o.seed == record.seed;
            outcomes.iter().any(|o| o.variant == name && same(o))
        };
        let at = known.iter().position(|(c, name)| *c == config && !clash(name)).unwrap_or_else(|| {
            let short = folder.file_name().map(|n| n.to_string_lossy().into_owned());
            let name = short.filter(|n| known.iter().all(|(_, k)| k != n));
            known.push((config.clone(), name.unwrap_or_else(|| folder.display().to_string())));
            known.len() - 1
        });
        outcomes.push(Outcome {
            variant: known[at].1.clone(),
            dataset,
            device: record.device.clone(),
            seed: record.seed,
            segment: String::new(),
            settings: differences(&known[0].0, &config),
            run: folder.clone(),
            state: OutcomeState::Done,
            metrics: self::metrics(&summary, &record),
        });
    }
    Ok(ResultSet {
        name: "compare".into(),
        title: "Comparison".into(),
        note: String::new(),
        head: "run".into(),
        metrics: metrics.to_vec(),
        baseline: outcomes.first().map(|o| o.variant.clone()).unwrap_or_default(),
        outcomes,
        paper: None,
    })
}

fn read<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, String> {
    let text = read_text(path).map_err(|e| format!("{}: {e}", path.display()))?;
    serde_json::from_str(&text).map_err(|e| format!("{}: {e}", path.display()))
}

/// Leaves of `config` that are not as in `base`, by dotted key.
fn differences(base: &Table, config: &Table) -> BTreeMap<String, String> {
    fn walk(prefix: &str, base: Option<&Table>, table: &Table, out: &mut BTreeMap<String, String>) {
        for (key, value) in table {
            let name = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
            let before = base.and_then(|b| b.get(key));
            match value {
                Value::Table(inner) => walk(&name, before.and_then(Value::as_table), inner, out),
                value if before != Some(value) => {
                    out.insert(name, value.to_string());
                }
                _ => {}
            }
        }
    }
    let mut out = BTreeMap::new();
    walk("", Some(base), config, &mut out);
    out
}
