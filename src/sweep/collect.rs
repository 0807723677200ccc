//! Turns a plan and the files that its runs have left so far into a set of results.

use super::halving;
use super::key::parts;
use super::plan::{Plan, PlanEntry};
use super::result::{
    MeasuredMetrics, Metrics, OF_RUNS, RunFailure, failure_path, live_psnr, metrics_path, read, read_metrics,
    read_segments, segments_path,
};
use crate::compare::{OutcomeState, ResultSet, VariantOutcome};
use crate::program::short;
use std::path::Path;

/// Collects the outcomes of the sweep in `dir`; those that are not done are included as missing, failed or stopped.
pub fn collect(plan: &Plan, dir: &Path) -> ResultSet {
    let stopped = plan.halving.as_ref().map(|_| halving::stopped(dir)).unwrap_or_default();
    let mut outcomes = Vec::new();
    for entry in in_table_order(plan) {
        let run = &plan.runs[entry.run];
        let folder = plan.run_folder(entry.run);
        let base = VariantOutcome {
            variant: entry.variant.clone(),
            dataset: run.dataset.clone(),
            device: run.device.clone(),
            seed: entry.seed,
            settings: entry.settings.clone(),
            run: folder.clone(),
            build: parts(&run.key).1.to_owned(),
            ..VariantOutcome::default()
        };
        let whole = read_metrics(&metrics_path(plan, entry.run));
        let failure = || read::<RunFailure>(&failure_path(&folder)).map(|f| format!("{}: {}", f.stage, f.error));
        let open = |metrics: Metrics| {
            let state = match (failure(), stopped.get(&run.key)) {
                (Some(error), _) => OutcomeState::Failed(error),
                (None, Some(step)) => OutcomeState::Stopped(*step),
                (None, None) => OutcomeState::Missing,
            };
            VariantOutcome { state, metrics, ..base.clone() }
        };
        let Some(index) = entry.segments else {
            outcomes.push(match whole {
                Some(MeasuredMetrics { build, metrics }) => VariantOutcome {
                    state: OutcomeState::Done,
                    measured_by: short(&build).to_owned(),
                    metrics,
                    ..base.clone()
                },
                None => {
                    let live = stopped.get(&run.key).and_then(|step| live_psnr(&folder, *step));
                    open(live.map(|(_, psnr)| ("psnr".to_owned(), psnr)).into_iter().collect())
                }
            });
            continue;
        };
        let shown = plan.metrics.iter().filter(|id| OF_RUNS.contains(&id.as_str()));
        let of_run: Metrics = shown.filter_map(|id| Some((id.clone(), *whole.as_ref()?.metrics.get(id)?))).collect();
        match read_segments(&segments_path(plan, entry.run, &run.segments[index])) {
            // no segment can be clicked at that time: shown as not measured, rather than omitted
            Some(scores) if scores.metrics.is_empty() => outcomes.push(open(Metrics::new())),
            None => outcomes.push(open(Metrics::new())),
            Some(scores) => outcomes.extend(scores.metrics.into_iter().map(|(segment, metrics)| VariantOutcome {
                segment,
                metrics: metrics.into_iter().chain(of_run.clone()).collect(),
                measured_by: short(&scores.build).to_owned(),
                state: OutcomeState::Done,
                ..base.clone()
            })),
        }
    }
    ResultSet {
        name: plan.name.clone(),
        title: plan.title.clone(),
        note: plan.note.clone(),
        head: plan.head.clone(),
        metrics: plan.metrics.clone(),
        baseline: plan.baseline.clone(),
        outcomes,
        paper: plan.paper.clone(),
    }
}

/// The entries in the order of a table, which has the seeds of a variant side by side; the plan has seeds outermost.
fn in_table_order(plan: &Plan) -> Vec<&PlanEntry> {
    let mut entries: Vec<&PlanEntry> = plan.entries.iter().collect();
    let mut variants: Vec<&str> = Vec::new();
    for entry in &plan.entries {
        if !variants.contains(&entry.variant.as_str()) {
            variants.push(&entry.variant);
        }
    }
    let place = |e: &PlanEntry| variants.iter().position(|v| *v == e.variant);
    let run = |e: &PlanEntry| (plan.runs[e.run].dataset.clone(), plan.runs[e.run].device.clone());
    entries.sort_by_key(|e| (run(e), place(e)));
    entries
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sweep::PlanOptions;
    use crate::sweep::result::write_measured;
    use std::collections::BTreeMap;

    #[test]
    fn rows_of_segments_show_what_is_of_the_whole_run() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("parts.toml");
        let text = "config = 'demo'\nmetrics = ['iou', 'psnr', 'fps']\n[segments]\nmethod = 'coarse'\n[data]\n\
                    jets = { synthetic = 'jets', segments = true, size = 40, times = 3, views = 4, test_views = 5 }\n";
        std::fs::write(&path, text).unwrap();
        let plan = Plan::new(&path, &PlanOptions { out: dir.path().to_owned(), ..PlanOptions::default() }).unwrap();
        std::fs::create_dir_all(plan.run_folder(0)).unwrap();
        let of = |values: &[(&str, f64)]| -> Metrics { values.iter().map(|(id, v)| ((*id).to_owned(), *v)).collect() };
        let whole = of(&[("psnr", 30.0), ("fps", 20.0), ("fps_with_copy", 10.0), ("gaussians", 5.0)]);
        write_measured(&metrics_path(&plan, 0), whole).unwrap();
        let segments = BTreeMap::from([("red".to_owned(), of(&[("iou", 80.0), ("psnr", 25.0)]))]);
        write_measured(&segments_path(&plan, 0, &plan.runs[0].segments[0]), segments).unwrap();
        let outcomes = collect(&plan, dir.path()).outcomes;
        assert_eq!((outcomes.len(), outcomes[0].segment.as_str()), (1, "red"));
        assert_eq!(outcomes[0].metrics, of(&[("iou", 80.0), ("psnr", 25.0), ("fps", 20.0)]));
    }
}
