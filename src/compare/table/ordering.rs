//! Whether variants rank in the paper's order, judged by confidence intervals.

use super::{ResultTable, TableRow};
use crate::compare::metric::{self, Better, MetricColumn};
use crate::compare::places::distinct;
use crate::compare::results::PaperTable;
use crate::compare::stats::{MeanDifference, difference, mean};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// How one metric ranks the variants, here and in the paper.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Ordering {
    /// Where the table is in the paper.
    pub source: String,
    /// The dataset that was measured.
    pub dataset: String,
    /// The device that was measured.
    pub device: String,
    /// The metric measured here.
    pub metric: MetricColumn,
    /// Whether all pairs hold.
    pub holds: bool,
    /// The pairs of variants that the paper distinguishes.
    pub pairs: Vec<VariantPair>,
    /// The metric, with the dataset and device if there are several.
    pub what: String,
    /// The paper's variants, best first, with a sign between neighbours.
    pub theirs: String,
    /// The variants measured here with their values, in the same form; empty if nothing was measured.
    pub ours: String,
    /// How many pairs hold, and the verdicts on the others.
    pub outcome: String,
    /// All of this in a sentence.
    pub text: String,
}

/// Two variants that the paper distinguishes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VariantPair {
    /// The better one in the paper.
    pub better: String,
    /// The worse one in the paper.
    pub worse: String,
    /// The verdict of the measurements here.
    pub verdict: Verdict,
    /// The difference measured here, `better` minus `worse`.
    pub difference: Option<MeanDifference>,
}

/// Whether a pair is in the paper's order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// The order is that of the paper.
    Holds,
    /// The order is reversed.
    Reversed,
    /// The interval of the difference includes zero or, without an interval, the displayed digits do not differ.
    Undecided,
    /// One of the two has no value here.
    Unmeasured,
}

/// Compares `table` with the paper's, for each metric that both have and each dataset and device. Variants that are in
/// only one of them are skipped.
///
/// If the paper has rows by segment (`variant/segment`), means over its segments are compared with means over the
/// segments measured here.
pub fn orderings(table: &ResultTable<'_>) -> Vec<Ordering> {
    let Some(paper) = &table.set.paper else {
        return Vec::new();
    };
    let mut out = Vec::new();
    let place = |row: &TableRow| (row.dataset.clone(), row.device.clone());
    for rows in table.rows.chunk_by(|a, b| place(a) == place(b)) {
        for (at, metric) in table.metrics.iter().enumerate() {
            if let Some(id) = paper_id(paper, table, at) {
                out.extend(ordering(paper, table, rows, at, metric, &id));
            }
        }
    }
    out
}

/// The paper's name for the table's metric `at`, if the paper has it.
fn paper_id(paper: &PaperTable, table: &ResultTable<'_>, at: usize) -> Option<String> {
    let ours = &table.metrics[at].id;
    let has = |id: &str| paper.rows.values().any(|row| row.contains_key(id));
    if has(ours) {
        return Some(ours.clone());
    }
    // the paper may give the abbreviation alone, such as that of LPIPS without its network
    let short = &table.metrics[at].short;
    let alike: Vec<String> = metric::known().into_iter().filter(|id| MetricColumn::by_id(id).short == *short).collect();
    let column = |id: &String| table.metrics.iter().position(|m| m.id == *id);
    let measured = |at: &usize| table.rows.iter().any(|row| row.cells[*at].n() > 0);
    let there: Vec<usize> = alike.iter().filter_map(column).collect();
    let chosen = there.iter().copied().find(measured).or(there.first().copied());
    let id = short.to_lowercase();
    (has(&id) && !alike.iter().any(|id| has(id)) && chosen == Some(at)).then_some(id)
}

fn ordering(
    paper: &PaperTable,
    table: &ResultTable<'_>,
    rows: &[TableRow],
    at: usize,
    metric: &MetricColumn,
    id: &str,
) -> Option<Ordering> {
    let (mut theirs, by_segment) = paper_values(paper, rows, id);
    theirs.sort_by(|a, b| metric.best_first(a.1, b.1));
    let ours = our_values(rows, at, by_segment);
    let values = |variant: &str| ours.get(variant).map_or(&[][..], Vec::as_slice);
    let mut pairs = Vec::new();
    for (i, (better, high)) in theirs.iter().enumerate() {
        for (worse, low) in &theirs[i + 1..] {
            if !same(*high, *low) {
                let found = difference(values(better), values(worse));
                let verdict = verdict(metric, values(better), values(worse), found);
                pairs.push(VariantPair { better: better.clone(), worse: worse.clone(), verdict, difference: found });
            }
        }
    }
    if pairs.is_empty() {
        return None;
    }
    let shown = |on: bool, name: &str| if on { Some(name.to_owned()) } else { None };
    let places: Vec<String> =
        [shown(table.shows.dataset, &rows[0].dataset), shown(table.shows.device, &rows[0].device)]
            .into_iter()
            .flatten()
            .collect();
    let place = if places.is_empty() { String::new() } else { format!(" ({})", places.join(", ")) };
    let mut found: Vec<(String, f64)> =
        theirs.iter().filter_map(|(name, _)| Some((name.clone(), mean_of(values(name))?))).collect();
    found.sort_by(|a, b| metric.best_first(a.1, b.1));
    let what = format!("{}{place}", metric.name());
    let published = chain(metric, &theirs, same, |name, _| name.to_owned());
    let alike = |a, b| metric.looks_same(a, b);
    let ours = chain(metric, &found, alike, |name, value| format!("{name} {}", metric.format(value)));
    let outcome = tally(metric, &pairs);
    let here = if ours.is_empty() { "nothing was measured" } else { &ours };
    let text = format!("{what}: {published} in the paper; here {here}: {outcome}");
    Some(Ordering {
        source: paper.source.clone(),
        dataset: rows[0].dataset.clone(),
        device: rows[0].device.clone(),
        metric: metric.clone(),
        holds: pairs.iter().all(|pair| pair.verdict == Verdict::Holds),
        pairs,
        what,
        theirs: published,
        ours,
        outcome,
        text,
    })
}

/// Whether both are equal up to rounding: a mean over segments depends on their order.
fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-9 * a.abs().max(b.abs())
}

fn mean_of(values: &[(u64, f64)]) -> Option<f64> {
    mean(&values.iter().map(|v| v.1).collect::<Vec<_>>())
}

/// The paper's value of each variant in `rows`, and whether these are means over segments.
fn paper_values(paper: &PaperTable, rows: &[TableRow], id: &str) -> (Vec<(String, f64)>, bool) {
    let variants = distinct(rows.iter().map(|row| row.variant.as_str()));
    let mut found: BTreeMap<&str, BTreeMap<&str, f64>> = BTreeMap::new();
    for (key, metrics) in &paper.rows {
        let value = metrics.get(id).copied().filter(|v| v.is_finite());
        // the longest name that matches, as names may contain slashes
        let fits = |name: &&&str| key.strip_prefix(**name).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'));
        if let (Some(value), Some(name)) = (value, variants.iter().filter(fits).max_by_key(|name| name.len())) {
            found.entry(name).or_default().insert(key[name.len()..].trim_start_matches('/'), value);
        }
    }
    let (whole, parts): (Vec<_>, Vec<_>) = found.values().flat_map(|by| by.keys().copied()).partition(|s| s.is_empty());
    let by_segment = whole.is_empty();
    let segments: BTreeSet<&str> = if by_segment { parts.into_iter().collect() } else { BTreeSet::from([""]) };
    let value = |name: &str| mean_over(found.get(name)?, &segments);
    let values = variants.iter().filter_map(|name| Some(((*name).to_owned(), value(name)?))).collect();
    (values, by_segment)
}

/// The mean over these segments; `None` if one is missing, as means over different segments cannot be compared fairly.
fn mean_over(by_segment: &BTreeMap<&str, f64>, segments: &BTreeSet<&str>) -> Option<f64> {
    let values: Option<Vec<f64>> = segments.iter().map(|segment| by_segment.get(segment).copied()).collect();
    mean(&values?)
}

/// The measured values of each variant by seed; means over all segments that any variant was measured on.
fn our_values(rows: &[TableRow], at: usize, by_segment: bool) -> BTreeMap<&str, Vec<(u64, f64)>> {
    let kind = |segments: bool| -> Vec<&TableRow> {
        rows.iter().filter(|row| row.segment.is_empty() != segments && row.cells[at].n() > 0).collect()
    };
    let wanted = kind(by_segment);
    let rows = if wanted.is_empty() { kind(!by_segment) } else { wanted };
    let segments: BTreeSet<&str> = rows.iter().map(|row| row.segment.as_str()).collect();
    let mut out: BTreeMap<&str, Vec<(u64, f64)>> = BTreeMap::new();
    if segments.len() < 2 {
        for row in rows {
            out.entry(&row.variant).or_default().extend(&row.cells[at].values);
        }
        return out;
    }
    let mut seeds: BTreeMap<(&str, u64), BTreeMap<&str, f64>> = BTreeMap::new();
    for row in rows {
        for (seed, value) in &row.cells[at].values {
            seeds.entry((&row.variant, *seed)).or_default().insert(&row.segment, *value);
        }
    }
    for ((variant, seed), by_segment) in seeds {
        out.entry(variant).or_default().extend(mean_over(&by_segment, &segments).map(|v| (seed, v)));
    }
    out
}

fn verdict(
    metric: &MetricColumn,
    better: &[(u64, f64)],
    worse: &[(u64, f64)],
    difference: Option<MeanDifference>,
) -> Verdict {
    let (Some(difference), Some(high), Some(low)) = (difference, mean_of(better), mean_of(worse)) else {
        return Verdict::Unmeasured;
    };
    let unseen = || metric.looks_same(high, low) || metric.shows_zero(difference.value);
    if difference.includes_zero().unwrap_or_else(unseen) {
        Verdict::Undecided
    } else if metric.best_first(high, low).is_lt() {
        Verdict::Holds
    } else {
        Verdict::Reversed
    }
}

fn sign(metric: &MetricColumn) -> &'static str {
    if metric.better == Better::Lower { "<" } else { ">" }
}

/// Best first, with a sign between neighbours.
fn chain(
    metric: &MetricColumn,
    sorted: &[(String, f64)],
    equal: impl Fn(f64, f64) -> bool,
    show: impl Fn(&str, f64) -> String,
) -> String {
    let mut out = String::new();
    for (i, (name, value)) in sorted.iter().enumerate() {
        if i > 0 {
            let sign = if equal(sorted[i - 1].1, *value) { "=" } else { sign(metric) };
            out += &format!(" {sign} ");
        }
        out += &show(name, *value);
    }
    out
}

/// How many pairs hold, and the verdicts on the others.
fn tally(metric: &MetricColumn, pairs: &[VariantPair]) -> String {
    let holding = pairs.iter().filter(|pair| pair.verdict == Verdict::Holds).count();
    let mut parts = match (holding, pairs.len()) {
        // the verdict on it follows
        (0, 1) => Vec::new(),
        (1, 1) => vec!["the pair holds".to_owned()],
        (2, 2) => vec!["both pairs hold".to_owned()],
        (k, n) if k == n => vec![format!("all {n} pairs hold")],
        (k, n) => vec![format!("{k} of {n} pairs hold")],
    };
    for pair in pairs {
        let what = match (pair.verdict, pair.difference.and_then(|d| d.interval)) {
            (Verdict::Holds, _) => continue,
            (Verdict::Reversed, _) => "is reversed",
            (Verdict::Undecided, Some(_)) => "is within noise",
            (Verdict::Undecided, None) => "is too close to tell",
            (Verdict::Unmeasured, _) => "is not measured",
        };
        parts.push(format!("{} {} {} {what}", pair.better, sign(metric), pair.worse));
    }
    let measured = || pairs.iter().filter_map(|pair| pair.difference);
    if measured().count() > 0 && measured().all(|d| d.interval.is_none()) {
        parts.push("without confidence intervals, which need two seeds".to_owned());
    }
    parts.join(", ")
}
