//! Run folders as outcomes, for `volseggs compare`.

use super::metric;
use super::results::{OutcomeState, ResultSet, VariantOutcome};
use crate::config::flatten;
use crate::eval::run::Summary;
use crate::files::{RunPaths, read_text};
use crate::memory::MIB;
use crate::program;
use crate::shell;
use crate::train::run::RunRecord;
use crate::versioned;
use crate::words::plain;
use std::collections::BTreeMap;
use std::fmt::{Display, Formatter};
use std::path::{Path, PathBuf};
use toml::Table;

/// Returns the metrics of an evaluated run, by id.
pub fn metrics(summary: &Summary, record: &RunRecord) -> BTreeMap<String, f64> {
    let mut metrics = BTreeMap::from([
        ("fps".to_owned(), summary.speed.fps),
        ("fps_with_copy".to_owned(), summary.speed.fps_with_copy),
        ("training_minutes".to_owned(), summary.training_seconds / 60.0),
        ("model_mb".to_owned(), summary.model_bytes as f64 / 1e6),
        ("model_mib".to_owned(), summary.model_bytes as f64 / MIB),
        ("gaussians".to_owned(), summary.gaussians as f64),
    ]);
    metrics.extend(summary.training_views.as_ref().map(|t| ("psnr_training".to_owned(), t.metrics.headline())));
    let parts = &summary.by_region;
    let psnr = [("psnr_edge", parts.edge.psnr), ("psnr_interior", parts.interior.psnr)];
    metrics.extend(psnr.into_iter().filter_map(|(name, v)| Some((name.to_owned(), v?))));
    if record.peak_memory_bytes > 0 {
        metrics.insert("peak_memory_gb".to_owned(), record.peak_memory_bytes as f64 / 1e9);
    }
    metrics.extend(summary.metrics.iter().map(|(name, value)| (name.to_owned(), value)));
    metrics
}

/// Why runs cannot be compared.
#[derive(Debug, thiserror::Error)]
pub enum CompareRunsError {
    /// A folder or one of its files.
    #[error("{}: {problem}", path.display())]
    Folder {
        /// The folder or file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// A metric that is unknown and that no run has.
    #[error("unknown metric \"{id}\"; available: {known}")]
    Metric {
        /// The requested id.
        id: String,
        /// All ids that can be requested.
        known: String,
    },
}

/// Refuses metrics that neither this program nor any of the outcomes knows.
fn check_metrics(metrics: &[String], outcomes: &[VariantOutcome]) -> Result<(), CompareRunsError> {
    let mut known = metric::known();
    for name in outcomes.iter().flat_map(|o| o.metrics.keys()) {
        if !known.contains(name) {
            known.push(name.clone());
        }
    }
    match metrics.iter().find(|m| !known.contains(m)) {
        Some(id) => Err(CompareRunsError::Metric { id: id.clone(), known: known.join(", ") }),
        None => Ok(()),
    }
}

/// Collects run folders, each evaluated by `volseggs eval`, into one set: runs whose configurations differ only in the
/// seed are one variant, named after the first one's folder. `metrics` are those to report.
///
/// # Errors
/// If a folder is given twice or is not a run; if it has not been evaluated on its test views at its present step, or
/// was evaluated at other times, or with another number or size of views, than another run of its dataset; or if a metric
/// is unknown.
pub fn from_folders(folders: &[PathBuf], metrics: &[String]) -> Result<ResultSet, CompareRunsError> {
    let mut known: Vec<(Table, String)> = Vec::new();
    let mut datasets: Vec<(String, String)> = Vec::new();
    let mut outcomes: Vec<VariantOutcome> = Vec::new();
    let mut met: Vec<PathBuf> = Vec::new();
    let mut measured: BTreeMap<String, (MeasurementSetup, PathBuf)> = BTreeMap::new();
    for folder in folders {
        let whole = std::fs::canonicalize(folder).unwrap_or_else(|_| folder.clone());
        if met.contains(&whole) {
            return Err(CompareRunsError::Folder {
                path: folder.clone(),
                problem: "is given twice; give each run once".into(),
            });
        }
        met.push(whole);
        let record: RunRecord = read(&RunPaths(folder).record(), "give folders that `volseggs train --out` made")?;
        let first = format!("run `volseggs eval {}` first", shell::path(folder));
        let summary: Summary = read(&RunPaths(folder).eval().join("test/mean.json"), &first)?;
        if let Some(steps) = summary.steps.filter(|steps| *steps != record.steps) {
            let problem = format!("was evaluated at step {steps} and is at step {} now", record.steps);
            let hint = format!("run `volseggs eval {}` again", shell::path(folder));
            return Err(CompareRunsError::Folder { path: folder.clone(), problem: format!("{problem}; {hint}") });
        }
        let path = RunPaths(folder).config();
        let bad = |problem: String| CompareRunsError::Folder { path: path.clone(), problem };
        let text = read_text(&path).map_err(|e| bad(e.to_string()))?;
        let mut config: Table = text.parse().map_err(|e: toml::de::Error| bad(plain(&e.to_string())))?;
        config.remove("seed");
        // datasets with the same name are distinguished by their full path
        let short = record.dataset.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let known_data = datasets.iter().find(|(print, _)| *print == record.fingerprint).map(|(_, name)| name.clone());
        let dataset = known_data.unwrap_or_else(|| {
            let whole = record.dataset.display().to_string();
            let is_free = |name: &String| datasets.iter().all(|(_, known)| known != name);
            // a folder that was prepared several times is several datasets
            let name = [short, whole.clone()].into_iter().find(is_free);
            let name = name.unwrap_or_else(|| format!("{whole} ({})", record.fingerprint));
            datasets.push((record.fingerprint.clone(), name.clone()));
            name
        });
        let on = MeasurementSetup::new(&summary, &config);
        let (first, other) = measured.entry(dataset.clone()).or_insert_with(|| (on.clone(), folder.clone()));
        if *first != on {
            let problem = format!("measured on {on}, but {} on {first}", other.display());
            let hint = format!("evaluate both in the same way with `volseggs eval {}`", shell::path(folder));
            return Err(CompareRunsError::Folder { path: folder.clone(), problem: format!("{problem}; {hint}") });
        }
        // a seed that a variant already has goes into another row, such as the same configuration from another version
        let clash = |name: &str| {
            let same = |o: &VariantOutcome| o.dataset == dataset && o.device == record.device && o.seed == record.seed;
            outcomes.iter().any(|o| o.variant == name && same(o))
        };
        let at = known.iter().position(|(c, name)| *c == config && !clash(name)).unwrap_or_else(|| {
            let name = row_name(folder, |name| known.iter().any(|(_, k)| k == name));
            known.push((config.clone(), name));
            known.len() - 1
        });
        outcomes.push(VariantOutcome {
            variant: known[at].1.clone(),
            dataset,
            device: record.device.clone(),
            seed: record.seed,
            segment: String::new(),
            settings: differences(&known[0].0, &config),
            run: folder.clone(),
            build: program::short(&record.build).to_owned(),
            measured_by: program::short(&summary.build).to_owned(),
            state: OutcomeState::Done,
            metrics: self::metrics(&summary, &record),
        });
    }
    check_metrics(metrics, &outcomes)?;
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

/// The first name for a row that is not taken: the folder's name, its path, or its path with a number.
fn row_name(folder: &Path, is_taken: impl Fn(&str) -> bool) -> String {
    let whole = folder.display().to_string();
    let short = folder.file_name().map_or_else(|| whole.clone(), |n| n.to_string_lossy().into_owned());
    let numbered = (2..).map(|n| format!("{whole} ({n})"));
    [short, whole.clone()].into_iter().chain(numbered).find(|name| !is_taken(name)).unwrap_or(whole)
}

/// What a run was measured on.
#[derive(Clone, PartialEq)]
struct MeasurementSetup {
    views: usize,
    size: [u32; 2],
    /// `data.only_times`, which selects the views; empty for all times.
    times: String,
}

impl MeasurementSetup {
    fn new(summary: &Summary, config: &Table) -> Self {
        let times = config.get("data").and_then(|data| data.get("only_times")).and_then(|times| times.as_array());
        let times: Vec<String> = times.into_iter().flatten().map(ToString::to_string).collect();
        Self { views: summary.views, size: [summary.width, summary.height], times: times.join(", ") }
    }
}

impl Display for MeasurementSetup {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} views of {}x{}", self.views, self.size[0], self.size[1])?;
        if self.times.is_empty() { Ok(()) } else { write!(f, " at data.only_times = {}", self.times) }
    }
}

/// Reads a JSON file of a run; `hint` says how to get it.
fn read<T: serde::de::DeserializeOwned>(path: &Path, hint: &str) -> Result<T, CompareRunsError> {
    let bad =
        |problem: String| CompareRunsError::Folder { path: path.to_owned(), problem: format!("{problem}; {hint}") };
    let text = read_text(path).map_err(|e| bad(e.to_string()))?;
    versioned::from_json(text).map_err(|e| bad(plain(&e.to_string())))
}

/// Returns the leaves of `config` that differ from `base`, by dotted key.
fn differences(base: &Table, config: &Table) -> BTreeMap<String, String> {
    let base = flatten(base);
    let differs = flatten(config).into_iter().filter(|(key, value)| base.get(key) != Some(value));
    differs.map(|(key, value)| (key, value.to_string())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_metrics_are_refused_with_the_known_ones() {
        let outcome =
            VariantOutcome { metrics: BTreeMap::from([("edge_error".to_owned(), 0.5)]), ..VariantOutcome::default() };
        let check = |ids: &[&str]| {
            check_metrics(&ids.iter().map(|id| (*id).to_owned()).collect::<Vec<_>>(), std::slice::from_ref(&outcome))
        };
        check(&["psnr", "lpips_alex", "edge_error"]).unwrap();
        let message = check(&["psnr", "foo"]).unwrap_err().to_string();
        assert!(
            message.contains("unknown metric \"foo\"; available: psnr, ssim") && message.contains("edge_error"),
            "{message}"
        );
    }

    #[test]
    fn a_missing_or_damaged_file_is_named_once() {
        let dir = tempfile::tempdir().unwrap();
        let message = || from_folders(&[dir.path().to_owned()], &[]).unwrap_err().to_string();
        let name = dir.path().display().to_string();
        let missing = message();
        assert!(missing.contains("run.json") && missing.matches(&name).count() == 1, "{missing}");
        std::fs::write(dir.path().join("run.json"), "garbage").unwrap();
        let damaged = message();
        assert!(damaged.contains("run.json") && damaged.matches(&name).count() == 1, "{damaged}");
    }

    /// Writes a run that was evaluated at step `steps`.
    fn write(folder: &Path, record: &RunRecord, config: &str, steps: usize) {
        let run = RunPaths(folder);
        std::fs::create_dir_all(run.eval().join("test")).unwrap();
        std::fs::write(run.record(), versioned::to_json(record).unwrap()).unwrap();
        std::fs::write(run.config(), config).unwrap();
        let summary = serde_json::json!({
            "format": 1, "split": "test", "dataset": "", "fingerprint": "", "build": "", "parameters": 1,
            "by_region": crate::eval::regions::ByRegion::default(), "views": 2, "psnr": 30.0, "ssim": 0.9, "ssim_gray": 0.9, "lpips_alex": null,
            "lpips_vgg": null, "fps": 9.0, "fps_frames": 4, "fps_with_copy": 8.0, "training_seconds": 1.0,
            "steps": steps, "model_bytes": 1, "gaussians": 1, "width": 4, "height": 4,
            "background": [1.0, 1.0, 1.0], "notes": []
        });
        std::fs::write(run.eval().join("test/mean.json"), summary.to_string()).unwrap();
    }

    #[test]
    fn a_folder_prepared_several_times_is_several_datasets() {
        let dir = tempfile::tempdir().unwrap();
        let folders: Vec<PathBuf> = ["a", "b", "c"].map(|name| dir.path().join(name)).to_vec();
        for (seed, folder) in folders.iter().enumerate() {
            let (dataset, fingerprint) = (PathBuf::from("/d/mine"), format!("print-{seed}"));
            let record = RunRecord { dataset, fingerprint, seed: seed as u64, ..RunRecord::default() };
            write(folder, &record, "", 0);
        }
        let set = from_folders(&folders, &[]).unwrap();
        let names: Vec<&str> = set.outcomes.iter().map(|o| o.dataset.as_str()).collect();
        assert_eq!(names, ["mine", "/d/mine", "/d/mine (print-2)"]);
    }

    #[test]
    fn configurations_are_never_averaged_as_seeds_of_one_name() {
        let dir = tempfile::tempdir().unwrap();
        let folders: Vec<PathBuf> = ["b/a", "a", "c/a"].map(|name| dir.path().join(name)).to_vec();
        for (n, folder) in folders.iter().enumerate() {
            write(folder, &RunRecord::default(), &format!("[loss]\ntv = 0.{n}"), 0);
        }
        let variants = |folders: &[PathBuf]| -> Vec<String> {
            from_folders(folders, &[]).unwrap().outcomes.into_iter().map(|o| o.variant).collect()
        };
        let [second, third] = [1, 2].map(|i| folders[i].display().to_string());
        assert_eq!(variants(&folders), ["a".to_owned(), second, third]);
        // even if the whole path is the short name of another run
        assert_eq!(row_name(Path::new("a"), |name| name == "a"), "a (2)");
    }

    #[test]
    fn runs_measured_at_different_times_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let [early, late] = ["early", "late"].map(|name| dir.path().join(name));
        write(&early, &RunRecord::default(), "[data]\nonly_times = [0.2]", 0);
        write(&late, &RunRecord { seed: 1, ..RunRecord::default() }, "[data]\nonly_times = [0.8]", 0);
        let message = from_folders(&[early.clone(), late], &[]).unwrap_err().to_string();
        for words in ["only_times = 0.2", "only_times = 0.8", "early", "late"] {
            assert!(message.contains(words), "{message}");
        }
        assert!(from_folders(&[early], &[]).is_ok());
    }

    #[test]
    fn an_evaluation_of_another_step_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let evaluated_at = |steps: usize| {
            write(dir.path(), &RunRecord { steps: 7, ..RunRecord::default() }, "", steps);
            from_folders(&[dir.path().to_owned()], &[])
        };
        assert_eq!(evaluated_at(7).unwrap().outcomes.len(), 1);
        let message = evaluated_at(5).unwrap_err().to_string();
        assert!(
            message.contains("evaluated at step 5 and is at step 7 now") && message.contains("volseggs eval"),
            "{message}"
        );
    }
}
