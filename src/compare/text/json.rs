//! A set, its table and the paper's order as one JSON value.

use crate::compare::metric::MetricColumn;
use crate::compare::results::ResultSet;
use crate::compare::table::{MetricCell, Ordering, ResultTable, TableRow};
use serde_json::{Map, Value, json};
use std::path::PathBuf;

/// Returns an object of `set` (which can be read back), `columns`, `rows` with their cells by metric, and `orderings`.
pub fn json(table: &ResultTable<'_>, orderings: &[Ordering]) -> Value {
    json!({
        "set": serde_json::to_value(writable(table.set)).unwrap_or_default(),
        "columns": table.metrics,
        "rows": table.rows.iter().map(|r| row(&table.metrics, r)).collect::<Vec<_>>(),
        "orderings": orderings,
    })
}

/// The set with paths as valid Unicode and without non-finite values, which JSON cannot hold.
fn writable(set: &ResultSet) -> ResultSet {
    let mut set = set.clone();
    for outcome in &mut set.outcomes {
        outcome.run = PathBuf::from(outcome.run.to_string_lossy().into_owned());
        outcome.metrics.retain(|_, value| value.is_finite());
    }
    for metrics in set.paper.iter_mut().flat_map(|paper| paper.rows.values_mut()) {
        metrics.retain(|_, value| value.is_finite());
    }
    set
}

fn row(metrics: &[MetricColumn], row: &TableRow) -> Value {
    let cells: Map<String, Value> = metrics.iter().zip(&row.cells).map(|(m, c)| (m.id.clone(), cell(c))).collect();
    let failures = row.failures.iter();
    json!({
        "dataset": row.dataset,
        "device": row.device,
        "segment": row.segment,
        "variant": row.variant,
        "done": row.done,
        "missing": row.missing,
        "stopped": row.stopped,
        "failed": row.failures.len(),
        "failures": failures
            .map(|f| json!({ "seed": f.seed, "run": f.run.to_string_lossy(), "error": f.error }))
            .collect::<Vec<_>>(),
        "metrics": cells,
    })
}

fn cell(cell: &MetricCell) -> Value {
    json!({
        "n": cell.n(),
        "mean": cell.mean,
        "std": cell.deviation,
        "best": cell.best,
        "difference": cell.difference,
    })
}
