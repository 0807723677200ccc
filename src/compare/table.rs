//! Outcomes as a table: a row for each variant, a cell for each metric with its mean over seeds, the best of each
//! column, and differences to the baseline. The comparison with the paper is in `ordering`, output formats in `text`.

mod ordering;
#[cfg(test)]
pub(crate) mod tests;

pub use ordering::{Ordering, VariantPair, Verdict, orderings};

use super::metric::{Better, MetricColumn};
use super::places::distinct;
use super::results::{OutcomeState, ResultSet, VariantOutcome};
use super::stats::{MeanDifference, deviation, difference, mean};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A table of results.
#[derive(Clone, Debug, PartialEq)]
pub struct ResultTable<'s> {
    /// What it is the table of.
    pub set: &'s ResultSet,
    /// The metrics, in the order of the cells.
    pub metrics: Vec<MetricColumn>,
    /// Which columns are shown.
    pub shows: Shows,
    /// The rows, grouped by dataset, device and segment.
    pub rows: Vec<TableRow>,
}

/// Which of the columns before the variant have more than one value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Shows {
    /// More than one dataset.
    pub dataset: bool,
    /// More than one device.
    pub device: bool,
    /// More than one segment.
    pub segment: bool,
}

/// A variant on one dataset, device and segment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TableRow {
    /// Name of the dataset.
    pub dataset: String,
    /// Name of the device.
    pub device: String,
    /// Name of the segment; empty for the whole scene.
    pub segment: String,
    /// Name of the variant.
    pub variant: String,
    /// One for each metric of the table.
    pub cells: Vec<MetricCell>,
    /// Number of measured outcomes; only these are in the cells.
    pub done: usize,
    /// Number of outcomes still missing.
    pub missing: usize,
    /// Number of outcomes stopped early.
    pub stopped: usize,
    /// Outcomes that ended with an error.
    pub failures: Vec<FailedRun>,
}

/// One metric of a row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MetricCell {
    /// Values by seed; all are finite.
    pub values: Vec<(u64, f64)>,
    /// Their mean.
    pub mean: Option<f64>,
    /// Their sample standard deviation; `None` for fewer than two values.
    pub deviation: Option<f64>,
    /// Whether it is the best of its column among the rows of its dataset, device and segment.
    pub best: bool,
    /// Difference to the baseline's row of the same dataset, device and segment.
    pub difference: Option<MeanDifference>,
}

/// A run that ended with an error.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FailedRun {
    /// Its seed.
    pub seed: u64,
    /// Its folder.
    pub run: PathBuf,
    /// The error.
    pub error: String,
}

impl<'s> ResultTable<'s> {
    /// Builds the table of a set. Rows are ordered by dataset, device, segment and variant, each in the order of its
    /// first appearance.
    pub fn new(set: &'s ResultSet) -> Self {
        let metrics = columns(set);
        let mut rows = rows(set, &metrics);
        for group in rows.chunk_by_mut(TableRow::same_group) {
            for (at, metric) in metrics.iter().enumerate() {
                mark_best(group, at, metric);
            }
            compare(group, &set.baseline);
        }
        let varies = |of: fn(&TableRow) -> &str| rows.windows(2).any(|pair| of(&pair[0]) != of(&pair[1]));
        let shows = Shows {
            dataset: varies(|row| &row.dataset),
            device: varies(|row| &row.device),
            segment: varies(|row| &row.segment),
        };
        Self { set, metrics, shows, rows }
    }

    /// Whether any cell has a difference to the baseline.
    pub fn has_differences(&self) -> bool {
        self.rows.iter().flat_map(|row| &row.cells).any(|cell| cell.difference.is_some())
    }

    /// Whether any difference has a confidence interval, which takes at least two seeds on both sides.
    pub fn has_intervals(&self) -> bool {
        let cells = self.rows.iter().flat_map(|row| &row.cells);
        cells.filter_map(|cell| cell.difference).any(|found| found.interval.is_some())
    }

    /// Returns the rows, grouped by dataset, device and segment.
    pub fn groups(&self) -> impl Iterator<Item = &[TableRow]> {
        self.rows.chunk_by(TableRow::same_group)
    }
}

impl TableRow {
    /// Whether both rows have the same dataset, device and segment.
    pub fn same_group(&self, other: &Self) -> bool {
        (&self.dataset, &self.device, &self.segment) == (&other.dataset, &other.device, &other.segment)
    }

    /// Total number of outcomes.
    pub fn outcomes(&self) -> usize {
        self.done + self.missing + self.stopped + self.failures.len()
    }

    fn new(outcome: &VariantOutcome, metrics: usize) -> Self {
        Self {
            dataset: outcome.dataset.clone(),
            device: outcome.device.clone(),
            segment: outcome.segment.clone(),
            variant: outcome.variant.clone(),
            cells: vec![MetricCell::default(); metrics],
            ..Self::default()
        }
    }

    fn add(&mut self, outcome: &VariantOutcome, metrics: &[MetricColumn]) {
        match &outcome.state {
            OutcomeState::Missing => self.missing += 1,
            OutcomeState::Stopped(_) => self.stopped += 1,
            OutcomeState::Failed(error) => {
                self.failures.push(FailedRun { seed: outcome.seed, run: outcome.run.clone(), error: error.clone() });
            }
            OutcomeState::Done => {
                self.done += 1;
                for (cell, metric) in self.cells.iter_mut().zip(metrics) {
                    let value = outcome.metrics.get(&metric.id).copied().filter(|v| v.is_finite());
                    cell.values.extend(value.map(|v| (outcome.seed, v)));
                }
            }
        }
    }
}

impl MetricCell {
    /// Number of values.
    pub fn n(&self) -> usize {
        self.values.len()
    }

    fn summarise(&mut self) {
        let values: Vec<f64> = self.values.iter().map(|v| v.1).collect();
        self.mean = mean(&values);
        self.deviation = deviation(&values);
    }
}

/// The columns of the set's metrics, each once.
fn columns(set: &ResultSet) -> Vec<MetricColumn> {
    distinct(set.metrics.iter()).into_iter().map(|id| MetricColumn::by_id(id)).collect()
}

fn rows(set: &ResultSet, metrics: &[MetricColumn]) -> Vec<TableRow> {
    let rank = |of: fn(&VariantOutcome) -> &str| {
        let mut ranks: BTreeMap<&str, usize> = BTreeMap::new();
        for outcome in &set.outcomes {
            let next = ranks.len();
            ranks.entry(of(outcome)).or_insert(next);
        }
        move |outcome: &VariantOutcome| ranks.get(of(outcome)).copied().unwrap_or(usize::MAX)
    };
    let (dataset, device, segment, variant) =
        (rank(|o| &o.dataset), rank(|o| &o.device), rank(|o| &o.segment), rank(|o| &o.variant));
    let mut rows: BTreeMap<[usize; 4], TableRow> = BTreeMap::new();
    for outcome in &set.outcomes {
        let key = [dataset(outcome), device(outcome), segment(outcome), variant(outcome)];
        rows.entry(key).or_insert_with(|| TableRow::new(outcome, metrics.len())).add(outcome, metrics);
    }
    let mut rows: Vec<TableRow> = rows.into_values().collect();
    rows.iter_mut().flat_map(|row| &mut row.cells).for_each(MetricCell::summarise);
    rows
}

/// Marks all rows whose displayed mean equals the best, if there is more than one to choose from.
fn mark_best(group: &mut [TableRow], at: usize, metric: &MetricColumn) {
    let means = || group.iter().filter_map(|row| row.cells[at].mean);
    let best = means().min_by(|a, b| metric.best_first(*a, *b));
    let (Some(best), true) = (best, means().count() > 1 && metric.better != Better::Neither) else {
        return;
    };
    for row in group {
        let cell = &mut row.cells[at];
        cell.best = cell.mean.is_some_and(|mean| metric.looks_same(mean, best));
    }
}

/// Fills in the differences to the baseline, if the group has it.
fn compare(group: &mut [TableRow], baseline: &str) {
    let Some(base) = group.iter().find(|row| row.variant == baseline).map(|row| row.cells.clone()) else {
        return;
    };
    for row in group.iter_mut().filter(|row| row.variant != baseline) {
        for (cell, base) in row.cells.iter_mut().zip(&base) {
            cell.difference = difference(&cell.values, &base.values);
        }
    }
}
