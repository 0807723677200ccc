//! Measurements in the form that tables and plots use: one outcome for each variant, dataset, device and seed.
//!
//! No files are read here; `sweep` and `compare::runs` fill these in.

use crate::program::build_label;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

/// A set of runs to be compared.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ResultSet {
    /// Name used in file names and labels: letters, digits, `-`, `_`.
    pub name: String,
    /// Heading of the report.
    pub title: String,
    /// A sentence or two below it; may be empty.
    pub note: String,
    /// Heading of the column of variants, such as `loss`.
    pub head: String,
    /// Ids of the metrics to report, in order; see [`super::metric`].
    pub metrics: Vec<String>,
    /// The variant that differences are relative to.
    pub baseline: String,
    /// One for each variant, dataset, device and seed, in the order of the table.
    pub outcomes: Vec<VariantOutcome>,
    /// The paper's version of the table.
    pub paper: Option<PaperTable>,
}

impl ResultSet {
    /// Returns a sentence naming the builds of the program that trained the measured runs and, where different, those
    /// that measured them; empty if none is known.
    pub fn builds(&self) -> String {
        let done = || self.outcomes.iter().filter(|o| o.state == OutcomeState::Done);
        let trained = builds(done().map(|o| (&o.run, o.build.as_str())));
        let measured = builds(done().filter(|o| o.measured_by != o.build).map(|o| (&o.run, o.measured_by.as_str())));
        if done().all(|o| o.build.is_empty() && o.measured_by.is_empty()) {
            return String::new();
        }
        let beside = if measured.is_empty() { String::new() } else { format!("; measured by {measured}") };
        format!("Trained by {trained} of the program{beside}.")
    }
}

/// Lists the builds of these runs, with the number of runs of each if there are several builds.
fn builds<'a>(runs: impl Iterator<Item = (&'a PathBuf, &'a str)>) -> String {
    let mut of: BTreeMap<&str, BTreeSet<&PathBuf>> = BTreeMap::new();
    for (run, build) in runs {
        of.entry(build).or_default().insert(run);
    }
    let several = of.len() > 1;
    let one = |(build, runs): (&str, BTreeSet<&PathBuf>)| {
        let name = build_label(build);
        let plural = if runs.len() == 1 { "" } else { "s" };
        if several { format!("{name} ({} run{plural})", runs.len()) } else { name }
    };
    of.into_iter().map(one).collect::<Vec<_>>().join(", ")
}

/// One variant with one seed on one dataset and device.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct VariantOutcome {
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
    /// Settings in which the variant's configuration differs from the base, by dotted key, as TOML text.
    pub settings: BTreeMap<String, String>,
    /// Folder of the run.
    pub run: PathBuf,
    /// Build of the program that trained it, as the first digits of its digest; empty if unknown.
    pub build: String,
    /// Build of the program that measured it, likewise.
    pub measured_by: String,
    /// How it ended.
    pub state: OutcomeState,
    /// Metrics by id; those that could not be measured are absent.
    pub metrics: BTreeMap<String, f64>,
}

/// The state of a run.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OutcomeState {
    /// Not started, or not finished.
    #[default]
    Missing,
    /// Measured.
    Done,
    /// Stopped early as unpromising, after this many steps (successive halving).
    Stopped(usize),
    /// Ended with this error.
    Failed(String),
}

/// A table of the paper.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PaperTable {
    /// Where it is in the paper and on which dataset, in words.
    pub source: String,
    /// Metrics by variant (`variant` or `variant/segment`), then by metric id.
    pub rows: BTreeMap<String, BTreeMap<String, f64>>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_names_its_builds() {
        let of = |run: &str, build: &str, measured_by: &str| VariantOutcome {
            run: run.into(),
            build: build.into(),
            measured_by: measured_by.into(),
            state: OutcomeState::Done,
            ..VariantOutcome::default()
        };
        let said =
            |outcomes: &[VariantOutcome]| ResultSet { outcomes: outcomes.to_vec(), ..ResultSet::default() }.builds();
        assert_eq!(said(&[]), "");
        assert_eq!(said(&[of("a", "", "")]), "");
        // two segments of one run
        assert_eq!(said(&[of("a", "11", "11"), of("a", "11", "11")]), "Trained by build 11 of the program.");
        assert_eq!(
            said(&[of("a", "11", "11"), of("b", "22", "22"), of("c", "22", "11")]),
            "Trained by build 11 (1 run), build 22 (2 runs) of the program; measured by build 11."
        );
        assert_eq!(
            said(&[of("a", "", "22"), of("b", "22", "22")]),
            "Trained by a build that was not recorded (1 run), build 22 (1 run) of the program; measured by build 22."
        );
        let missing = VariantOutcome { state: OutcomeState::Missing, ..of("a", "33", "") };
        assert_eq!(said(&[missing, of("b", "11", "11")]), "Trained by build 11 of the program.");
    }
}
