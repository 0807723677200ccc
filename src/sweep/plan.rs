//! The plan of a sweep: every run resolved, checked and keyed before the first one starts.
//!
//! Two variants may ask for the same training (they then differ in how segments are measured): a *run* is one
//! training, an *entry* is one place in the table.

use super::SweepError;
use super::axes::{Variant, all_seeds, check_count, variants};
use super::checks::{
    baseline, check_halving, check_lists, check_metrics, check_paper, check_plan, check_seed_keys, check_views,
};
use super::contents::ContentDigests;
use super::datasets::{DataPlan, check_truth, datasets, fingerprint};
use super::file::{EvalSpec, HalvingSpec, SweepFile, name_of};
use super::key::{key, recipe, short_hash};
use super::resolve::{Base, ResolvedVariant};
use crate::compare::PaperTable;
use crate::compare::metric;
use crate::eval::segments::SegmentEvalOptions;
use crate::memory::MemoryBudget;
use crate::method;
use crate::program;
use crate::versioned;
use clap::Args;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// Default folder of sweeps.
pub const FOLDER: &str = "checkpoints/sweeps";

/// What is requested in addition to the file.
#[derive(Args, Clone, Debug, Default)]
pub struct PlanOptions {
    /// Folder of sweeps: OUT/NAME for this one, OUT/runs for the runs of all.
    #[arg(long, default_value = FOLDER, value_name = "OUT")]
    pub out: PathBuf,
    /// Datasets to use instead of the file's; may be repeated.
    #[arg(long, value_name = "DATASET")]
    pub data: Vec<PathBuf>,
    /// Set a key in every run, unless a variant sets it; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Set a key of every synthetic dataset of the file, such as size=64 for a trial; may be repeated.
    #[arg(long, value_name = "KEY=VALUE", conflicts_with = "data")]
    pub synthetic: Vec<String>,
    /// Seeds to use instead of the file's.
    #[arg(long, value_name = "N,...", value_delimiter = ',', allow_hyphen_values = true)]
    pub seeds: Vec<u64>,
    /// Devices to use instead of the file's.
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    pub devices: Vec<String>,
    /// LPIPS weights (safetensors); may be given twice.
    #[arg(long, value_name = "FILE")]
    pub lpips_weights: Vec<PathBuf>,
    /// Whether the runs are for other machines, whose devices this one need not have.
    #[arg(skip)]
    pub elsewhere: bool,
}

/// A sweep, ready to run; stored as `plan.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Version of the program.
    pub version: String,
    /// Digest of the program, see [`crate::program`].
    pub build: String,
    /// Name of the sweep's folder.
    pub name: String,
    /// Heading of the report.
    pub title: String,
    /// Text below it.
    pub note: String,
    /// Heading of the column of variants.
    pub head: String,
    /// Metrics to report.
    pub metrics: Vec<String>,
    /// Variant that differences are relative to.
    pub baseline: String,
    /// How runs are measured.
    pub eval: EvalSpec,
    /// Digests of the weights and masks that they are measured with.
    pub contents: ContentDigests,
    /// Early stopping.
    pub halving: Option<HalvingSpec>,
    /// The paper's figures.
    pub paper: Option<PaperTable>,
    /// Folder of all runs; beside the sweep's own folder, wherever that is mounted.
    #[serde(skip)]
    pub runs_folder: PathBuf,
    /// Datasets by name; synthetic ones are rendered before the first run.
    pub datasets: BTreeMap<String, DataPlan>,
    /// The training runs.
    pub runs: Vec<PlannedRun>,
    /// The places in the table, with seeds outermost.
    pub entries: Vec<PlanEntry>,
}

/// One training run and what is measured of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlannedRun {
    /// Hash of configuration, dataset, device, version and tag, and the build that trains it; the name of its folder.
    /// See [`super::key`].
    pub key: String,
    /// A name for progress lines and messages.
    pub label: String,
    /// The device.
    pub device: String,
    /// Name of the dataset.
    pub dataset: String,
    /// The resolved configuration, as TOML.
    pub config: String,
    /// Steps of the whole training.
    pub steps: usize,
    /// Measurements of segments.
    pub segments: Vec<SegmentEvalOptions>,
}

/// One variant on one dataset and device with one seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanEntry {
    /// The variant's name.
    pub variant: String,
    /// The seed.
    pub seed: u64,
    /// Where it differs from the base, as TOML text.
    pub settings: BTreeMap<String, String>,
    /// Index of its run, from 0.
    pub run: usize,
    /// Index of its measurement of segments in the run's list, from 0.
    pub segments: Option<usize>,
}

impl Plan {
    /// Resolves and checks everything that the file `path` requests. Nothing is written.
    ///
    /// # Errors
    /// The first problem that would keep something from running, naming file, key and variant.
    pub fn new(path: &Path, options: &PlanOptions) -> Result<Self, SweepError> {
        let mut file = SweepFile::read(path)?;
        let build = program::build().map_err(|e| SweepError::io(&e.file, &e.reason))?;
        let seeds = match &file.seeds {
            _ if !options.seeds.is_empty() => {
                // seeds of the command line apply to all variants
                file.variant.iter_mut().for_each(|variant| variant.seeds = None);
                options.seeds.clone()
            }
            Some(seeds) => seeds.clone(),
            None => vec![0],
        };
        if !options.devices.is_empty() {
            file.devices = options.devices.clone();
        }
        if file.devices.is_empty() {
            file.devices = vec!["flex".to_owned()];
        }
        file.eval.lpips_weights.extend(options.lpips_weights.iter().cloned());
        file.set_synthetic(&options.synthetic).map_err(|problem| file.wrong("--synthetic", problem))?;
        check_lists(&file, &seeds, options.elsewhere)?;
        check_seed_keys(&file, options)?;
        let places = options.data.len().max(file.data.len()).saturating_mul(file.devices.len());
        check_count(&file, seeds.len(), places, MemoryBudget::now())?;
        let variants = variants(&file)?;
        let baseline = baseline(&file, &variants)?;
        check_paper(&file, &variants)?;
        let datasets = datasets(&file, &options.data, &options.out)?;
        let known = metric::known();
        if let Some(unknown) = file.metrics.iter().find(|m| !known.contains(m)) {
            let problem = format!("unknown metric \"{unknown}\"; available: {}", known.join(", "));
            return Err(file.wrong("metrics", problem));
        }
        let mut plan = Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            build: build.digest.clone(),
            name: name_of(path),
            title: file.title.clone(),
            note: file.note.clone(),
            head: file.head.clone(),
            metrics: file.metrics.clone(),
            baseline,
            eval: file.eval.clone(),
            contents: ContentDigests::default(),
            halving: file.halving.clone(),
            paper: file.paper.clone(),
            runs_folder: options.out.join("runs"),
            datasets,
            runs: Vec::new(),
            entries: Vec::new(),
        };
        let base = Base { file: &file, path, options };
        let mut fingerprints = HashMap::new();
        let mut placed = PlacedRuns::default();
        // seeds outermost, so that a first table is available early
        for seed in all_seeds(&seeds, &variants) {
            for (dataset, data) in plan.datasets.clone() {
                for device in &file.devices {
                    for variant in variants.iter().filter(|variant| variant.seeds(&seeds).contains(&seed)) {
                        let one = base.resolve(variant, seed)?;
                        let downscale = one.config.data.downscale;
                        let print = match fingerprints.entry((dataset.clone(), downscale)) {
                            std::collections::hash_map::Entry::Occupied(known) => known.into_mut(),
                            std::collections::hash_map::Entry::Vacant(new) => {
                                new.insert(fingerprint(&data, downscale, &file, &dataset)?)
                            }
                        };
                        let key = key(&recipe(&one.toml, print, device, &file.tag), &build.digest);
                        plan.place(variant, seed, (&dataset, device), one, key, &mut placed)
                            .map_err(|e| file.wrong(format!("variant \"{}\"", variant.name), e))?;
                    }
                }
            }
        }
        let has_segments = plan.entries.iter().any(|e| e.segments.is_some());
        check_metrics(&plan).map_err(|e| file.wrong("metrics", e))?;
        check_views(&plan).map_err(|e| file.wrong("data", e))?;
        if has_segments {
            check_truth(&plan.datasets, &file)?;
        }
        if plan.metrics.is_empty() {
            plan.metrics = match has_segments {
                true => metric::default_columns(&["iou_3d", "iou"], &[]),
                false => metric::default_columns(&[], &["training_minutes"]),
            };
        }
        if let Some(halving) = &plan.halving {
            check_halving(halving, &plan).map_err(|e| file.wrong("halving", e))?;
        }
        let specs = plan.runs.iter().flat_map(|run| &run.segments);
        let contents = ContentDigests::read(&plan.eval.lpips_weights, specs);
        plan.contents = contents.map_err(|(key, problem)| file.wrong(key, problem))?;
        Ok(plan)
    }

    /// Adds an entry, and its run if there is none with that key yet.
    fn place(
        &mut self,
        variant: &Variant,
        seed: u64,
        (dataset, device): (&str, &str),
        one: ResolvedVariant,
        key: String,
        placed: &mut PlacedRuns,
    ) -> Result<(), String> {
        let index = *placed.runs.entry(key.clone()).or_insert_with(|| {
            let several = |one: bool, text: String| if one { String::new() } else { text };
            self.runs.push(PlannedRun {
                key,
                label: format!(
                    "{}{}{} seed {seed}",
                    variant.name,
                    several(self.datasets.len() < 2, format!(" {dataset}")),
                    several(device == "flex", format!(" {device}"))
                ),
                device: device.to_owned(),
                dataset: dataset.to_owned(),
                config: one.toml,
                steps: method::find(&one.config.method).map_or(0, |method| method.steps(&one.config)),
                segments: Vec::new(),
            });
            self.runs.len() - 1
        });
        let run = &mut self.runs[index];
        let segments = one.segments.map(|spec| {
            run.segments.iter().position(|s| *s == spec).unwrap_or_else(|| {
                run.segments.push(spec);
                run.segments.len() - 1
            })
        });
        if let Some(twin) = placed.entries.insert((index, segments), self.entries.len()) {
            let twin = &self.entries[twin];
            return Err(format!(
                "the same configuration as \"{}\" (seed {}); a sweep cannot have duplicates, so remove one",
                twin.variant, twin.seed
            ));
        }
        let text = |(k, v): (&String, &toml::Value)| (k.clone(), v.to_string());
        let mut settings: BTreeMap<_, _> = variant.settings.iter().map(text).collect();
        settings.extend(variant.config.iter().map(|config| ("config".to_owned(), config.clone())));
        self.entries.push(PlanEntry { variant: variant.name.clone(), seed, settings, run: index, segments });
        Ok(())
    }

    /// Returns the folder of run `index`.
    pub fn run_folder(&self, index: usize) -> PathBuf {
        self.runs_folder.join(&self.runs[index].key)
    }

    /// Writes `plan.json` into `dir`, which is created if missing, and beside it `plans/HASH.json`, which stays when
    /// the sweep file is edited and planned again, so that earlier workers still find what they were started for.
    /// Returns the hash.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn save(&self, dir: &Path) -> Result<String, SweepError> {
        let plans = dir.join("plans");
        std::fs::create_dir_all(&plans).map_err(|e| SweepError::io(&plans, e))?;
        let (text, hash) = (self.text(), self.hash());
        for path in [plans.join(format!("{hash}.json")), dir.join("plan.json")] {
            crate::files::write_atomic(&path, text.as_bytes()).map_err(|e| SweepError::io(&path, e))?;
        }
        Ok(hash)
    }

    fn text(&self) -> String {
        // only maps whose keys are not text have no JSON form, and a plan has none of these
        let text = versioned::to_json_pretty(self).unwrap_or_default();
        String::from_utf8(text).unwrap_or_default()
    }

    /// Returns what distinguishes this plan from others of the same sweep, eight hexadecimal digits.
    pub fn hash(&self) -> String {
        short_hash(&self.text())
    }

    /// Reads the plan of the sweep in `dir`: the newest, or the one with that hash.
    ///
    /// # Errors
    /// If it is missing, damaged, or not a plan of this version of the program.
    pub fn load(dir: &Path, hash: Option<&str>) -> Result<Self, SweepError> {
        let path = hash.map_or(dir.join("plan.json"), |hash| dir.join("plans").join(format!("{hash}.json")));
        let text = crate::files::read_text(&path).map_err(|e| SweepError::io(&path, e))?;
        let plan = versioned::from_json(&text)
            .map_err(|e| e.to_string())
            .and_then(|plan: Self| check_plan(&plan).map(|()| plan))
            .map_err(|e| SweepError::io(&path, format!("{e}; plan again with `volseggs sweep FILE`")))?;
        // the path `.` has no parent
        let whole = std::fs::canonicalize(dir).map_err(|e| SweepError::io(dir, e))?;
        let runs_folder = whole.parent().map(|out| out.join("runs")).unwrap_or_default();
        Ok(Self { runs_folder, ..plan })
    }
}

/// What has been placed in a plan already.
#[derive(Default)]
struct PlacedRuns {
    /// Runs by key.
    runs: HashMap<String, usize>,
    /// Entries by run and measurement of segments.
    entries: HashMap<(usize, Option<usize>), usize>,
}

#[cfg(test)]
#[path = "plan_tests.rs"]
mod tests;
