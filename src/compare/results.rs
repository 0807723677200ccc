//! What was measured, as tables and plots take it: one outcome for each variant, dataset, device and seed.
//!
//! No files are read here; `sweep` and `compare::runs` fill these in.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A set of runs to be laid side by side.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ResultSet {
    /// Name in file names and labels: letters, digits, `-`, `_`.
    pub name: String,
    /// Heading of the report.
    pub title: String,
    /// A sentence or two below it; may be empty.
    pub note: String,
    /// Heading of the column of variants, such as `loss`.
    pub head: String,
    /// Ids of the metrics to report, in order; see [`super::metric::metric`].
    pub metrics: Vec<String>,
    /// The variant that differences are taken to.
    pub baseline: String,
    /// One for each variant, dataset, device and seed, in the order of the table.
    pub outcomes: Vec<Outcome>,
    /// The same table as the paper has it.
    pub paper: Option<PaperTable>,
}

/// One variant with one seed on one dataset and device.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// Name of the variant; outcomes that differ in the seed alone share it.
    pub variant: String,
    /// Name of the dataset.
    pub dataset: String,
    /// Name of the device.
    pub device: String,
    /// The seed.
    pub seed: u64,
    /// The known segment that was measured; empty for the whole scene.
    pub segment: String,
    /// Where the variant's configuration differs from the base, by dotted key, as TOML text.
    pub settings: BTreeMap<String, String>,
    /// Folder of the run.
    pub run: PathBuf,
    /// How it ended.
    pub state: OutcomeState,
    /// Metrics by id; those that could not be measured are absent.
    pub metrics: BTreeMap<String, f64>,
}

/// How far a run has come.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OutcomeState {
    /// Not begun, or not at its end.
    #[default]
    Missing,
    /// Measured.
    Done,
    /// Given up as hopeless after so many steps (successive halving).
    Stopped(usize),
    /// Ended with this error.
    Failed(String),
}

/// A table of the paper.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PaperTable {
    /// Where it stands and on which dataset, in words.
    pub source: String,
    /// Metrics by variant (`variant` or `variant/segment`), then by metric id.
    pub rows: BTreeMap<String, BTreeMap<String, f64>>,
}
