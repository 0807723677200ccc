//! A comparison as one HTML page: headline figures, tables, curves, costs, settings, pictures, runs.
//!
//! This file defines the sections and their order; plots are made in `plots`, lists of runs in `runs`. The caller
//! supplies finished tables.

mod plots;
mod runs;
#[cfg(test)]
mod tests;

use super::metric::MetricColumn;
use super::places::{DatasetOnDevice, distinct};
use super::results::{OutcomeState, ResultSet, VariantOutcome};
use super::sheet::{VariantSheet, sheets};
use super::stats;
use crate::export::images::encode_png;
use crate::report::{Report, ReportBlock, ReportSection};

/// Builds the page of `set` with `tables` and, below them, `order`: how the order of variants agrees with the paper's.
/// Curves, configurations and pictures are read from the run folders; missing ones are omitted.
pub fn report(set: &ResultSet, mut tables: Vec<ReportBlock>, order: Option<ReportBlock>) -> Report {
    let against = set.paper.as_ref().map_or_else(String::new, |paper| format!("The paper: {}.", paper.source));
    if tables.is_empty() {
        tables.push(ReportBlock::Missing { what: "the table".to_owned(), how: String::new() });
    }
    let sections = vec![
        ReportSection::new("summary", "At a glance", "", vec![ReportBlock::Numbers(runs::headline(set))]),
        ReportSection::new("table", "Table", "", tables),
        ReportSection::new("order", "Comparison with the paper", against, order.into_iter().collect()),
        ReportSection::new(
            "curves",
            "Learning curves",
            "Means over seeds. Test PSNR is measured on the few views that are evaluated during training.",
            plots::learning(set),
        ),
        ReportSection::new(
            "cost",
            "Quality against cost",
            "Means over seeds; whiskers are one standard deviation.",
            plots::cost(set),
        ),
        ReportSection::new(
            "settings",
            "Settings and outcome",
            "One line per run, through the settings that vary.",
            plots::settings(set),
        ),
        ReportSection::new(
            "views",
            "The same view",
            "The ground truth, then each variant's first seed above its error map.",
            sheets(set).iter().map(view_sheet).collect(),
        ),
        ReportSection::new("runs", "Runs", "", runs::list(set)),
        ReportSection::new("failures", "Failures", "", runs::failures(set)),
    ];
    let title = if set.title.trim().is_empty() { set.name.clone() } else { set.title.clone() };
    let sections = sections.into_iter().filter(|section| !section.blocks.is_empty()).collect();
    Report { title, subtitle: set.note.clone(), sections }
}

fn view_sheet(sheet: &VariantSheet) -> ReportBlock {
    let VariantSheet { dataset, view, top_error, left_out, .. } = sheet;
    let mut caption = format!(
        "View {view} of {dataset}. Errors are mean absolute differences of the channels, where 1 is full intensity; \
         the brightest colour stands for {top_error} or more."
    );
    if !left_out.is_empty() {
        caption += &format!(" Not shown: {}.", left_out.join(", "));
    }
    match encode_png(&sheet.image) {
        Ok(png) => ReportBlock::Figure { png, alt: format!("Renders and error maps of {dataset}"), caption },
        Err(e) => ReportBlock::Missing { what: format!("the pictures of {dataset}"), how: e.to_string() },
    }
}

/// All variants, in the order of the table.
fn variants(set: &ResultSet) -> Vec<&str> {
    distinct(set.outcomes.iter().map(|o| o.variant.as_str()))
}

/// The name of an outcome's row in the table.
fn row_name(outcome: &VariantOutcome) -> String {
    if outcome.segment.is_empty() {
        outcome.variant.clone()
    } else {
        format!("{}/{}", outcome.variant, outcome.segment)
    }
}

/// The metric `id` of a finished outcome, if it is finite.
fn value(outcome: &VariantOutcome, id: &str) -> Option<f64> {
    let done = outcome.state == OutcomeState::Done;
    outcome.metrics.get(id).copied().filter(|v| done && v.is_finite())
}

/// Mean over the seeds (and segments, if there are several) of a variant.
fn variant_mean(set: &ResultSet, place: &DatasetOnDevice, variant: &str, id: &str) -> Option<f64> {
    let outcomes = set.outcomes.iter().filter(|o| place.holds(o) && o.variant == variant);
    stats::mean(&outcomes.filter_map(|o| value(o, id)).collect::<Vec<_>>())
}

/// The main metric of the page: the first of the set.
fn first_metric(set: &ResultSet) -> Option<MetricColumn> {
    set.metrics.first().map(|id| MetricColumn::by_id(id))
}
