//! The runs of a comparison: headline figures, a list, and why some failed.

use super::plots::quantity;
use super::{first_metric, row_name, value, variant_mean, variants};
use crate::compare::metric::{Better, MetricColumn};
use crate::compare::places::{DatasetOnDevice, distinct, places};
use crate::compare::results::{OutcomeState, ResultSet, VariantOutcome};
use crate::report::{Headline, ReportBlock};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Maximum number of places whose best variant is a headline figure.
const MAX_PLACES: usize = 4;

/// The headline figures: number of measured outcomes, best variant of each place, total training time.
pub(super) fn headline(set: &ResultSet) -> Vec<Headline> {
    let count = |of: fn(&OutcomeState) -> bool| set.outcomes.iter().filter(|o| of(&o.state)).count();
    let done = count(|state| *state == OutcomeState::Done);
    let others = [
        (count(|state| matches!(state, OutcomeState::Failed(_))), "failed"),
        (count(|state| matches!(state, OutcomeState::Stopped(_))), "stopped early"),
        (count(|state| *state == OutcomeState::Missing), "not finished"),
    ];
    let others = others.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}"));
    let of_all = if done == set.outcomes.len() { String::new() } else { format!("of {}", set.outcomes.len()) };
    let mut numbers = vec![Headline {
        value: done.to_string(),
        unit: of_all,
        name: "outcomes measured".to_owned(),
        note: others.collect::<Vec<_>>().join(", "),
    }];
    numbers.extend(places(set).iter().take(MAX_PLACES).filter_map(|place| best(set, place)));
    let minutes = distinct(set.outcomes.iter().map(|o| (&o.run, value(o, "training_minutes"))));
    let minutes: f64 = minutes.into_iter().filter_map(|(_, minutes)| minutes).sum();
    if minutes > 0.0 {
        let (value, unit) =
            if minutes < 120.0 { (format!("{minutes:.1}"), "min") } else { (format!("{:.1}", minutes / 60.0), "h") };
        let name = "total training".to_owned();
        numbers.push(Headline { value, unit: unit.to_owned(), name, note: String::new() });
    }
    numbers
}

/// The best variant by the first metric, and its difference to the baseline.
fn best(set: &ResultSet, place: &DatasetOnDevice) -> Option<Headline> {
    let MetricColumn { id, head, digits, better, .. } = first_metric(set)?;
    let higher = match better {
        Better::Higher => true,
        Better::Lower => false,
        Better::Neither => return None,
    };
    // means over different segments cannot be compared fairly
    let segments = |variant: &str| -> BTreeSet<&str> {
        let of_it = set.outcomes.iter().filter(|o| place.holds(o) && o.variant == variant && value(o, &id).is_some());
        of_it.map(|o| o.segment.as_str()).collect()
    };
    let mut measured = variants(set).into_iter().map(segments).filter(|s| !s.is_empty());
    let first = measured.next()?;
    if measured.any(|other| other != first) {
        return None;
    }
    let means = variants(set).into_iter().filter_map(|v| Some((v, variant_mean(set, place, v, &id)?)));
    let (variant, mean) = means.reduce(|a, b| if (b.1 > a.1) == higher && b.1 != a.1 { b } else { a })?;
    let unit = head.split_once(", ").map_or("", |(_, unit)| unit);
    let mut note = if place.name.is_empty() { variant.to_owned() } else { format!("{variant}; {}", place.name) };
    if let Some(base) = variant_mean(set, place, &set.baseline, &id).filter(|_| variant != set.baseline) {
        note += &format!("; {:+.digits$} to {}", mean - base, set.baseline);
    }
    let name = format!("best {}", quantity(&head));
    Some(Headline { value: format!("{mean:.digits$}"), unit: unit.to_owned(), name, note })
}

/// Heading, whether it is shown, and its cells.
type TextColumn<'a> = (&'a str, bool, fn(&VariantOutcome) -> &String);

/// The list of all outcomes.
pub(super) fn list(set: &ResultSet) -> Vec<ReportBlock> {
    if set.outcomes.is_empty() {
        return vec![ReportBlock::Missing { what: "runs".to_owned(), how: String::new() }];
    }
    let folder = common_folder(set.outcomes.iter().map(|o| o.run.as_path()));
    let name = if set.head.is_empty() { "variant" } else { &set.head };
    // columns that are empty or constant only make the table wider
    let all = &set.outcomes;
    let several = |of: fn(&VariantOutcome) -> &String| all.iter().any(|o| of(o) != of(&all[0]));
    let columns: [TextColumn<'_>; 4] = [
        (name, true, |o| &o.variant),
        ("segment", several(|o| &o.segment) || !all[0].segment.is_empty(), |o| &o.segment),
        ("dataset", several(|o| &o.dataset), |o| &o.dataset),
        ("device", several(|o| &o.device), |o| &o.device),
    ];
    let columns: Vec<_> = columns.into_iter().filter(|(_, on, _)| *on).collect();
    let mut head: Vec<String> = columns.iter().map(|(name, ..)| (*name).to_owned()).collect();
    head.extend(["seed", "state"].map(String::from));
    let metrics: Vec<MetricColumn> = set.metrics.iter().map(|id| MetricColumn::by_id(id)).collect();
    head.extend(metrics.iter().map(|metric| metric.head.clone()));
    head.push("run".to_owned());
    let row = |o: &VariantOutcome| {
        let mut row: Vec<String> = columns.iter().map(|(_, _, of)| of(o).clone()).collect();
        row.extend([o.seed.to_string(), state(&o.state)]);
        row.extend(metrics.iter().map(|metric| {
            let value = o.metrics.get(&metric.id).filter(|v| v.is_finite());
            value.map_or_else(|| "–".to_owned(), |v| metric.format(*v))
        }));
        row.push(o.run.strip_prefix(&folder).unwrap_or(&o.run).display().to_string());
        row
    };
    let caption = match folder.display().to_string() {
        none if none.is_empty() => String::new(),
        folder => format!("Run folders are in {folder}."),
    };
    vec![ReportBlock::Table { head, rows: set.outcomes.iter().map(row).collect(), caption, highlight: None }]
}

fn state(state: &OutcomeState) -> String {
    match state {
        OutcomeState::Missing => "not finished".to_owned(),
        OutcomeState::Done => "done".to_owned(),
        OutcomeState::Stopped(steps) => format!("stopped at step {steps}"),
        OutcomeState::Failed(_) => "failed".to_owned(),
    }
}

/// The deepest folder that contains all `runs`; empty if there is none.
fn common_folder<'a>(runs: impl Iterator<Item = &'a Path>) -> PathBuf {
    let parents = runs.map(|run| run.parent().unwrap_or(Path::new("")).to_owned());
    let common = parents.reduce(|a, b| {
        a.components().zip(b.components()).take_while(|(x, y)| x == y).map(|(x, _)| x).collect::<PathBuf>()
    });
    common.filter(|folder| folder.parent().is_some()).unwrap_or_default()
}

/// The error of each failed run.
pub(super) fn failures(set: &ResultSet) -> Vec<ReportBlock> {
    let text = |o: &VariantOutcome| {
        let OutcomeState::Failed(error) = &o.state else { return None };
        let of = [row_name(o), o.dataset.clone(), o.device.clone(), format!("seed {}", o.seed)];
        let of: Vec<String> = of.into_iter().filter(|part| !part.is_empty()).collect();
        Some(ReportBlock::Text(format!("{}\n{}\n{}", of.join(", "), o.run.display(), error.trim())))
    };
    set.outcomes.iter().filter_map(text).collect()
}
