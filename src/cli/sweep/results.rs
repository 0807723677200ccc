//! `volseggs sweep status` and `volseggs sweep collect`.

use super::{CliError, Planned};
use crate::cli::print_json;
use crate::compare::write::write_report;
use crate::log::progress::duration;
use crate::sweep::Plan;
use crate::sweep::claim::holder;
use crate::sweep::collect::collect;
use crate::sweep::halving;
use crate::sweep::result::{Metrics, Progress, live_psnr, metrics_path, progress, read};
use crate::sweep::slurm::{Tools, queue};
use clap::Args;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

#[derive(Debug, Args)]
pub(super) struct StatusArgs {
    #[command(flatten)]
    planned: Planned,
    /// Print one JSON object on standard output.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
pub(super) struct CollectArgs {
    #[command(flatten)]
    planned: Planned,
    /// Print one JSON object on standard output.
    #[arg(long)]
    json: bool,
}

/// How far one run is.
#[derive(Serialize)]
struct RunStatus {
    task: usize,
    key: String,
    label: String,
    state: &'static str,
    step: usize,
    steps: usize,
    psnr: Option<f64>,
    detail: String,
}

impl StatusArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (dir, plan) = self.planned.open()?;
        let tools = Tools::default();
        let queued = if dir.join("slurm").is_dir() && tools.have("squeue") {
            queue(&tools, &dir, &plan.hash())?
        } else {
            BTreeMap::new()
        };
        let stopped = halving::stopped(&dir);
        let status = |task: usize| -> RunStatus {
            let run = &plan.runs[task];
            let folder = plan.run_folder(task);
            let live = live_psnr(&folder, usize::MAX);
            let step = live.map_or(0, |(s, _)| s);
            let measured: Option<Metrics> = read(&metrics_path(&folder, &plan.eval));
            let psnr = measured.and_then(|m| m.get("psnr").copied()).or(live.map(|(_, p)| p));
            let (state, detail) = match (progress(&plan, task), stopped.get(&run.key), queued.get(&task)) {
                (Progress::Done, ..) => ("done", String::new()),
                (Progress::Failed(failure), ..) => ("failed", format!("{}: {}", failure.stage, failure.error)),
                (Progress::Open, Some(step), _) => ("stopped", format!("at step {step}")),
                (Progress::Open, None, Some(q)) if q.runs() => {
                    ("running", format!("{} {} on {}", q.id, duration(q.seconds as f64), q.place))
                }
                (Progress::Open, None, Some(q)) => ("queued", format!("{} {} {}", q.id, q.state, q.place)),
                (Progress::Open, None, None) => match holder(&folder) {
                    Some(holder) => ("running", holder.to_string()),
                    None if step > 0 => ("begun", "goes on at the next call".to_owned()),
                    None => ("to do", String::new()),
                },
            };
            RunStatus {
                task,
                key: run.key.clone(),
                label: run.label.clone(),
                state,
                step,
                steps: run.steps,
                psnr,
                detail,
            }
        };
        let all: Vec<RunStatus> = (0..plan.runs.len()).map(status).collect();
        if self.json {
            return print_json(&serde_json::json!({ "runs": all }));
        }
        let width = all.iter().map(|r| r.label.len()).max().unwrap_or(0).min(60);
        for r in &all {
            let psnr = r.psnr.map(|p| format!("{p:.2} dB")).unwrap_or_default();
            outln!("{:4} {} {:width$} {:8} {psnr:9} {}", r.task, r.key, r.label, r.state, r.detail);
        }
        let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
        all.iter().for_each(|r| *counts.entry(r.state).or_default() += 1);
        let counts: Vec<String> = counts.iter().map(|(state, n)| format!("{n} {state}")).collect();
        errln!("{} runs: {}", all.len(), counts.join(", "));
        Ok(())
    }
}

impl CollectArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (dir, plan) = self.planned.open()?;
        report(&plan, &dir, self.json)
    }
}

/// Writes the report of what is done; prints its table, or the results as JSON.
pub(super) fn report(plan: &Plan, dir: &Path, json: bool) -> Result<(), CliError> {
    let set = collect(plan, dir);
    let text = write_report(dir, &set).map_err(CliError::failure)?;
    errln!("report: {}", dir.join("report.html").display());
    if json {
        return print_json(&set);
    }
    out!("{text}");
    Ok(())
}
