//! All outcomes as comma-separated values, one line each, for other programs.

use crate::compare::places::distinct;
use crate::compare::results::{OutcomeState, ResultSet};
use crate::csv::field;
use std::collections::BTreeSet;

/// Columns that every set has.
const FIXED: [&str; 7] = ["variant", "dataset", "device", "seed", "segment", "state", "run"];

/// Writes one line per outcome: what identifies it, settings by key, metrics by id. Missing values are empty.
///
/// A setting or metric whose name an earlier column has is headed `setting.NAME` or `metric.NAME`.
pub fn csv(set: &ResultSet) -> String {
    let settings: BTreeSet<&String> = set.outcomes.iter().flat_map(|o| o.settings.keys()).collect();
    let others: BTreeSet<&String> = set.outcomes.iter().flat_map(|o| o.metrics.keys()).collect();
    let metrics = distinct(set.metrics.iter().chain(others));
    let mut head: Vec<String> = FIXED.map(str::to_owned).to_vec();
    let named = settings.iter().map(|key| ("setting", *key)).chain(metrics.iter().map(|id| ("metric", *id)));
    for (kind, name) in named {
        let taken = head.contains(name);
        head.push(if taken { format!("{kind}.{name}") } else { name.clone() });
    }
    let mut out = line(&head);
    for outcome in &set.outcomes {
        let mut cells = vec![
            outcome.variant.clone(),
            outcome.dataset.clone(),
            outcome.device.clone(),
            outcome.seed.to_string(),
            outcome.segment.clone(),
            state(&outcome.state).to_owned(),
            outcome.run.to_string_lossy().into_owned(),
        ];
        cells.extend(settings.iter().map(|key| outcome.settings.get(*key).map_or_else(String::new, |v| plain(v))));
        let value = |id: &&String| outcome.metrics.get(*id).filter(|v| v.is_finite()).map(f64::to_string);
        cells.extend(metrics.iter().map(|id| value(id).unwrap_or_default()));
        out += &line(&cells);
    }
    out
}

/// How an outcome ended, in a word.
fn state(state: &OutcomeState) -> &'static str {
    match state {
        OutcomeState::Missing => "missing",
        OutcomeState::Done => "done",
        OutcomeState::Stopped(_) => "stopped",
        OutcomeState::Failed(_) => "failed",
    }
}

/// A TOML string without its quotes; any other text unchanged.
fn plain(text: &str) -> String {
    let parsed = toml::from_str::<toml::Table>(&format!("value = {text}"));
    match parsed.ok().and_then(|mut table| table.remove("value")) {
        Some(toml::Value::String(inner)) => inner,
        _ => text.to_owned(),
    }
}

fn line(cells: &[String]) -> String {
    cells.iter().map(|cell| field(cell)).collect::<Vec<_>>().join(",") + "\n"
}
