//! A table as rows of plain text, before any escaping; used by both Markdown and pages.

use crate::compare::metric::{Better, MetricColumn};
use crate::compare::table::{MetricCell, ResultTable, TableRow};

/// Rows of text under a heading.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TextGrid {
    /// Headings of the columns.
    pub head: Vec<String>,
    /// Rows, each as long as the heading.
    pub rows: Vec<Vec<TextCell>>,
    /// Number of columns on the left that hold words; the others hold numbers.
    pub words: usize,
}

/// The text of a cell.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TextCell {
    /// The text.
    pub text: String,
    /// Whether it is the best of its column.
    pub bold: bool,
}

impl From<String> for TextCell {
    fn from(text: String) -> Self {
        Self { text, bold: false }
    }
}

impl TextGrid {
    /// Returns the rows with the best cells enclosed in `**`.
    pub fn starred(&self) -> Vec<Vec<String>> {
        let star = |e: &TextCell| if e.bold { format!("**{}**", e.text) } else { e.text.clone() };
        self.rows.iter().map(|row| row.iter().map(star).collect()).collect()
    }
}

/// Shown where there is no value.
const NONE: &str = "–";

/// Whether every row has the same number of runs, all of them measured.
pub(super) fn is_complete(table: &ResultTable<'_>) -> bool {
    table.rows.iter().all(|row| row.done == row.outcomes() && row.done == table.rows[0].done)
}

/// Rows of their names and an entry for each metric.
fn grid<'t>(
    table: &ResultTable<'_>,
    rows: impl Iterator<Item = &'t TableRow>,
    entry: impl Fn(&MetricColumn, &MetricCell, &TableRow) -> TextCell,
) -> TextGrid {
    let mut head = names_head(table);
    let words = head.len();
    head.extend(table.metrics.iter().map(heading));
    let rows = rows.map(|row| {
        let mut entries = names(table, row);
        entries.extend(table.metrics.iter().zip(&row.cells).map(|(metric, cell)| entry(metric, cell, row)));
        entries
    });
    TextGrid { head, rows: rows.collect(), words }
}

/// Mean and deviation of each metric, and the number of runs if it differs between rows or some were not measured.
pub fn results(table: &ResultTable<'_>) -> TextGrid {
    let mut grid = grid(table, table.rows.iter(), value);
    if !is_complete(table) {
        grid.head.push("runs".to_owned());
        grid.rows.iter_mut().zip(&table.rows).for_each(|(entries, row)| entries.push(runs(row).into()));
    }
    grid
}

/// Differences to the baseline with their intervals; `None` if there are none.
pub fn differences(table: &ResultTable<'_>) -> Option<TextGrid> {
    let others = table.rows.iter().filter(|row| row.variant != table.set.baseline);
    table.has_differences().then(|| grid(table, others, |metric, cell, _| difference(metric, cell).into()))
}

/// Headings of the columns that name a row.
pub(super) fn names_head(table: &ResultTable<'_>) -> Vec<String> {
    let shows = table.shows;
    let variant = if table.set.head.is_empty() { "variant" } else { table.set.head.as_str() };
    [(shows.dataset, "dataset"), (shows.device, "device"), (shows.segment, "segment"), (true, variant)]
        .into_iter()
        .filter(|(on, _)| *on)
        .map(|(_, name)| name.to_owned())
        .collect()
}

/// The entries of a row in those columns.
pub(super) fn names(table: &ResultTable<'_>, row: &TableRow) -> Vec<TextCell> {
    let shows = table.shows;
    let segment = if row.segment.is_empty() { "whole scene" } else { &row.segment };
    [(shows.dataset, &*row.dataset), (shows.device, &*row.device), (shows.segment, segment), (true, &*row.variant)]
        .into_iter()
        .filter(|(on, _)| *on)
        .map(|(_, name)| name.to_owned().into())
        .collect()
}

fn heading(metric: &MetricColumn) -> String {
    match metric.better {
        Better::Higher => format!("{} ↑", metric.head),
        Better::Lower => format!("{} ↓", metric.head),
        Better::Neither => metric.head.clone(),
    }
}

fn value(metric: &MetricColumn, cell: &MetricCell, row: &TableRow) -> TextCell {
    let Some(mean) = cell.mean else {
        return NONE.to_owned().into();
    };
    let mut text = metric.format(mean);
    if let Some(deviation) = cell.deviation {
        text += &format!(" ± {}", metric.format(deviation));
    }
    if cell.n() != row.done {
        text += &format!(" (n = {})", cell.n());
    }
    TextCell { text, bold: cell.best }
}

fn difference(metric: &MetricColumn, cell: &MetricCell) -> String {
    let Some(found) = cell.difference else {
        return NONE.to_owned();
    };
    let value = metric.signed(found.value);
    match found.interval {
        Some([low, high]) => format!("{value} [{}, {}]", metric.format(low), metric.format(high)),
        None => value,
    }
}

/// How many runs of a row were measured, and why the others were not.
pub(super) fn runs(row: &TableRow) -> String {
    if row.done == row.outcomes() {
        return row.done.to_string();
    }
    let rest = [(row.failures.len(), "failed"), (row.stopped, "stopped"), (row.missing, "missing")];
    let rest: Vec<String> = rest.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")).collect();
    format!("{} of {} ({})", row.done, row.outcomes(), rest.join(", "))
}
