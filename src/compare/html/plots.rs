//! The plots of a comparison: learning curves, quality against cost, settings against outcome.

use super::{first_metric, row_name, value, variant_mean, variants};
use crate::compare::curves::{Curves, mean, smooth};
use crate::compare::metric::{Better, MetricColumn};
use crate::compare::places::{DatasetOnDevice, distinct, places};
use crate::compare::results::{OutcomeState, ResultSet, VariantOutcome};
use crate::compare::stats;
use crate::config::short_key;
use crate::draw::parallel::{ParallelAxis, ParallelLine, Ticks, parallel_plot};
use crate::draw::plot::{PlotSeries, line_plot};
use crate::draw::scatter::{ScatterPoint, scatter_plot};
use crate::files::RunPaths;
use crate::nesting::check_toml;
use crate::report::ReportBlock;
use std::path::Path;

/// Maximum number of curves in a plot: the number that its legend names.
const MAX_CURVES: usize = 12;
/// Maximum number of settings in a parallel-coordinates plot.
const MAX_SETTINGS: usize = 8;
/// Cost in the scatter plots: metric and axis label.
const COST: (&str, &str) = ("training_minutes", "training, min");
/// Ratio of the largest to the smallest value from which a numeric setting has a logarithmic axis.
const LOG_FROM: f64 = 15.0;

/// Three plots for each place: test and training PSNR over steps, test PSNR over time.
pub(super) fn learning(set: &ResultSet) -> Vec<ReportBlock> {
    places(set).iter().flat_map(|place| learning_at(set, place)).collect()
}

fn learning_at(set: &ResultSet, place: &DatasetOnDevice) -> Vec<ReportBlock> {
    let mut curves: Vec<(&str, Curves)> = variants(set)
        .into_iter()
        .map(|variant| (variant, mean(&runs_of(set, place, variant))))
        .filter(|(_, curves)| *curves != Curves::default())
        .collect();
    let all = curves.len();
    if all > MAX_CURVES {
        let names: Vec<&str> = curves.iter().map(|(variant, _)| *variant).collect();
        let kept = best(set, place, &names, MAX_CURVES);
        curves.retain(|(variant, _)| kept.contains(variant));
    }
    let note =
        if all > curves.len() { format!(" The best {} of {all} variants.", curves.len()) } else { String::new() };
    let plot = |title: &str, x: &str, points: fn(&Curves) -> Vec<(f64, f64)>| {
        let series: Vec<PlotSeries> = curves
            .iter()
            .map(|(variant, c)| PlotSeries { name: (*variant).to_owned(), points: points(c) })
            .filter(|s| !s.points.is_empty())
            .collect();
        (!series.is_empty()).then(|| ReportBlock::Svg {
            svg: line_plot(&titled(title, place), x, "PSNR, dB", &series),
            caption: format!("{title}.{note}"),
        })
    };
    [
        plot("Test PSNR over steps", "step", |c| c.test.clone()),
        plot("Training PSNR over steps, smoothed", "step", |c| smooth(&c.train)),
        plot("Test PSNR over time", "training, s", |c| c.test_by_seconds.clone()),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// A plot's title with the place, where places have names.
fn titled(title: &str, place: &DatasetOnDevice) -> String {
    if place.name.is_empty() { title.to_owned() } else { format!("{title}: {}", place.name) }
}

/// Folders of the finished runs of a variant, or of all its runs if none is finished.
fn runs_of<'a>(set: &'a ResultSet, place: &DatasetOnDevice, variant: &str) -> Vec<&'a Path> {
    let of = |done: bool| {
        let outcomes = set.outcomes.iter().filter(|o| place.holds(o) && o.variant == variant);
        // Segments of a run share its folder.
        distinct(outcomes.filter(|o| !done || o.state == OutcomeState::Done).map(|o| o.run.as_path()))
    };
    let done = of(true);
    if done.is_empty() { of(false) } else { done }
}

/// The baseline and the best variants by the first metric, at most `max` in all.
fn best<'a>(set: &ResultSet, place: &DatasetOnDevice, names: &[&'a str], max: usize) -> Vec<&'a str> {
    let mut ranked = names.to_vec();
    if let Some(MetricColumn { id, better, .. }) = first_metric(set) {
        let rank = |name: &str| {
            if name == set.baseline {
                return f64::NEG_INFINITY;
            }
            let value = variant_mean(set, place, name, &id).unwrap_or(f64::NAN);
            let rank = if better == Better::Lower { value } else { -value };
            if rank.is_nan() { f64::INFINITY } else { rank }
        };
        ranked.sort_by(|a, b| rank(a).total_cmp(&rank(b)));
    }
    ranked.truncate(max);
    ranked
}

/// A plot of the first metric against training time for each place.
pub(super) fn cost(set: &ResultSet) -> Vec<ReportBlock> {
    let Some(MetricColumn { id, head, .. }) = first_metric(set).filter(|first| first.id != COST.0) else {
        return Vec::new();
    };
    let variants = variants(set);
    let at = |place: &DatasetOnDevice| {
        let rows = distinct(set.outcomes.iter().filter(|o| place.holds(o)).map(row_name));
        let points: Vec<ScatterPoint> = rows
            .into_iter()
            .filter_map(|name| {
                let outcomes = || set.outcomes.iter().filter(|o| place.holds(o) && row_name(o) == name);
                let group = variants.iter().position(|v| outcomes().any(|o| o.variant == *v))?;
                let both: Vec<(f64, f64)> =
                    outcomes().filter_map(|o| Some((value(o, COST.0)?, value(o, &id)?))).collect();
                let (xs, ys): (Vec<f64>, Vec<f64>) = both.into_iter().unzip();
                let (x_error, y_error) = (stats::deviation(&xs), stats::deviation(&ys));
                Some(ScatterPoint { x: stats::mean(&xs)?, y: stats::mean(&ys)?, x_error, y_error, group, name })
            })
            .collect();
        // a single point has nothing to be compared with
        (points.len() > 1).then(|| ReportBlock::Svg {
            svg: scatter_plot(&titled(&format!("{} against cost", quantity(&head)), place), COST.1, &head, &points),
            caption: format!("{head} against minutes of training, for each variant."),
        })
    };
    places(set).iter().filter_map(at).collect()
}

/// The heading of a metric without its unit.
pub(super) fn quantity(head: &str) -> &str {
    head.split_once(", ").map_or(head, |(quantity, _)| quantity)
}

/// A parallel-coordinates plot for each place where at least two settings vary, in at least four combinations.
pub(super) fn settings(set: &ResultSet) -> Vec<ReportBlock> {
    places(set).iter().filter_map(|place| settings_at(set, place)).collect()
}

/// A value of a setting.
#[derive(Clone, Debug, PartialEq)]
enum SettingValue {
    Number(f64),
    Text(String),
}

fn settings_at(set: &ResultSet, place: &DatasetOnDevice) -> Option<ReportBlock> {
    let MetricColumn { id, head, .. } = first_metric(set)?;
    let outcomes: Vec<(&VariantOutcome, f64)> =
        set.outcomes.iter().filter(|o| place.holds(o)).filter_map(|o| Some((o, value(o, &id)?))).collect();
    let configs: Vec<Option<toml::Table>> = outcomes.iter().map(|(o, _)| config(&o.run)).collect();
    let mut keys = distinct(outcomes.iter().flat_map(|(o, _)| o.settings.keys()));
    keys.sort();
    let mut columns: Vec<(&String, Vec<Option<SettingValue>>, usize)> = keys
        .into_iter()
        .map(|key| {
            let values: Vec<_> = outcomes.iter().zip(&configs).map(|((o, _), c)| setting(o, c.as_ref(), key)).collect();
            let count = distinct(values.iter().flatten()).len();
            (key, values, count)
        })
        .filter(|(_, _, count)| *count > 1)
        .collect();
    let ways = distinct((0..outcomes.len()).map(|i| columns.iter().map(|c| c.1[i].clone()).collect::<Vec<_>>()));
    if columns.len() < 2 || ways.len() < 4 {
        return None;
    }
    let mut left_out = Vec::new();
    if columns.len() > MAX_SETTINGS {
        let mut ranked: Vec<(usize, &String)> = columns.iter().map(|c| (c.2, c.0)).collect();
        ranked.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(b.1)));
        left_out = ranked.split_off(MAX_SETTINGS).into_iter().map(|(_, key)| key.clone()).collect();
        columns.retain(|c| !left_out.contains(c.0));
    }
    let names: Vec<&str> = columns.iter().map(|c| c.0.as_str()).collect();
    let mut lines: Vec<ParallelLine> = outcomes
        .iter()
        .map(|(o, _)| ParallelLine { name: format!("{}, seed {}", row_name(o), o.seed), values: Vec::new() })
        .collect();
    let mut axes = Vec::new();
    for (key, values, _) in &columns {
        let (ticks, numbers) = axis(values);
        axes.push(ParallelAxis { name: short_key(key, &names).to_owned(), ticks });
        lines.iter_mut().zip(numbers).for_each(|(line, number)| line.values.push(number));
    }
    axes.push(ParallelAxis { name: head.clone(), ticks: Ticks::Linear });
    lines.iter_mut().zip(&outcomes).for_each(|(line, (_, value))| line.values.push(Some(*value)));
    let mut caption = format!("Settings of each run ({}) and {head}.", names.join(", "));
    if !left_out.is_empty() {
        caption += &format!(" Not shown: {}.", left_out.join(", "));
    }
    Some(ReportBlock::Svg { svg: parallel_plot(&titled("Settings and outcome", place), &axes, &lines), caption })
}

/// The ticks of an axis for these values, and the position of each value on it.
fn axis(values: &[Option<SettingValue>]) -> (Ticks, Vec<Option<f64>>) {
    let number = |value: &SettingValue| match value {
        SettingValue::Number(number) => Some(*number),
        SettingValue::Text(_) => None,
    };
    let numbers: Option<Vec<f64>> = values.iter().flatten().map(number).collect();
    if let Some(numbers) = numbers {
        let low = numbers.iter().copied().fold(f64::INFINITY, f64::min);
        let high = numbers.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let ticks = if low > 0.0 && high / low >= LOG_FROM { Ticks::Log } else { Ticks::Linear };
        return (ticks, values.iter().map(|v| v.as_ref().and_then(number)).collect());
    }
    let text = |value: &SettingValue| match value {
        SettingValue::Number(number) => number.to_string(),
        SettingValue::Text(text) => text.clone(),
    };
    let mut names = distinct(values.iter().flatten().map(text));
    names.sort();
    let place = |value: &SettingValue| names.iter().position(|n| *n == text(value)).map(|at| at as f64);
    let places = values.iter().map(|v| v.as_ref().and_then(place)).collect();
    (Ticks::Names(names), places)
}

/// The run's resolved configuration, which also has the settings that a variant leaves at the base's value.
fn config(run: &Path) -> Option<toml::Table> {
    let text = crate::files::read_text(&RunPaths(run).config()).ok()?;
    check_toml(&text).ok()?;
    text.parse().ok()
}

fn setting(outcome: &VariantOutcome, config: Option<&toml::Table>, key: &str) -> Option<SettingValue> {
    let Some(text) = outcome.settings.get(key) else {
        let (folder, name) = key.rsplit_once('.').map_or((None, key), |(folder, name)| (Some(folder), name));
        let mut table = config?;
        for part in folder.into_iter().flat_map(|folder| folder.split('.')) {
            table = table.get(part)?.as_table()?;
        }
        return table.get(name).map(of_value);
    };
    let parsed = check_toml(text).ok().and_then(|()| format!("value = {text}").parse::<toml::Table>().ok());
    Some(parsed.and_then(|t| t.get("value").map(of_value)).unwrap_or_else(|| SettingValue::Text(text.clone())))
}

fn of_value(value: &toml::Value) -> SettingValue {
    match value {
        toml::Value::Integer(number) => SettingValue::Number(*number as f64),
        toml::Value::Float(number) if number.is_finite() => SettingValue::Number(*number),
        toml::Value::String(text) => SettingValue::Text(text.clone()),
        other => SettingValue::Text(other.to_string()),
    }
}
