//! `volseggs sweep status` and `volseggs sweep collect`.

use super::{CliError, Planned};
use crate::cli::print_json;
use crate::compare::write::write_report;
use crate::durations::duration;
use crate::program::{self, build_label};
use crate::sweep::Plan;
use crate::sweep::builds::{OtherBuilds, view};
use crate::sweep::claim::holder;
use crate::sweep::collect::collect;
use crate::sweep::halving;
use crate::sweep::key::parts;
use crate::sweep::local::steps_done;
use crate::sweep::result::{RunCompletion, live_psnr, metrics_in, metrics_path, progress, read_metrics};
use crate::sweep::slurm::{SlurmTools, queue};
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
    /// Use a run finished by another build if the sweep's own build has not finished it.
    #[arg(long)]
    any_build: bool,
    /// Print one JSON object on standard output.
    #[arg(long)]
    json: bool,
}

/// A run of the same configuration that another build finished.
#[derive(Serialize)]
struct OtherBuildRun {
    key: String,
    build: String,
    psnr: Option<f64>,
}

/// The progress of one run.
#[derive(Serialize)]
struct RunStatus {
    task: usize,
    key: String,
    label: String,
    /// Build that trains or trained it.
    build: String,
    state: &'static str,
    step: usize,
    steps: usize,
    psnr: Option<f64>,
    detail: String,
    other_builds: Vec<OtherBuildRun>,
}

impl StatusArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (dir, plan) = self.planned.open()?;
        let tools = SlurmTools::default();
        let queued = if dir.join("slurm").is_dir() && tools.have("squeue") {
            queue(&tools, &dir, &plan.hash())?
        } else {
            BTreeMap::new()
        };
        // the file may be of an earlier plan of this sweep
        let stopped = if plan.halving.is_some() { halving::stopped(&dir) } else { BTreeMap::default() };
        let others = OtherBuilds::find(&plan);
        let psnr_in = |path: &Path| read_metrics(path).and_then(|m| m.metrics.get("psnr").copied());
        let status = |task: usize| -> RunStatus {
            let run = &plan.runs[task];
            let folder = plan.run_folder(task);
            let live = live_psnr(&folder, usize::MAX);
            let step = live.map_or(0, |(s, _)| s).max(steps_done(&folder));
            let psnr = psnr_in(&metrics_path(&plan, task)).or(live.map(|(_, p)| p));
            let (state, mut detail) = match (progress(&plan, task), stopped.get(&run.key), queued.get(&task)) {
                (RunCompletion::Done, ..) => ("done", String::new()),
                (RunCompletion::Failed(failure), ..) => ("failed", format!("{}: {}", failure.stage, failure.error)),
                (RunCompletion::Open, Some(step), _) => ("stopped", format!("at step {step}")),
                (RunCompletion::Open, None, Some(q)) if q.runs() => {
                    ("running", format!("{} {} on {}", q.id, duration(q.seconds as f64), q.place))
                }
                (RunCompletion::Open, None, Some(q)) => ("queued", format!("{} {} {}", q.id, q.state, q.place)),
                (RunCompletion::Open, None, None) => match holder(&folder) {
                    Some(holder) => ("running", holder.to_string()),
                    None if step > 0 => ("begun", "resumes at the next call".to_owned()),
                    None => ("to do", String::new()),
                },
            };
            let other_run = |key: &String| OtherBuildRun {
                key: key.clone(),
                build: parts(key).1.to_owned(),
                psnr: psnr_in(&metrics_in(&plan, task, &plan.runs_folder.join(key))),
            };
            let other_builds: Vec<OtherBuildRun> = others.of_run(task).iter().map(other_run).collect();
            if let (Some(other), true) = (other_builds.first(), state != "done") {
                let psnr = other.psnr.map(|p| format!(" ({p:.2} dB)")).unwrap_or_default();
                let comma = if detail.is_empty() { "" } else { "; " };
                detail += &format!("{comma}finished by {}{psnr}", build_label(&other.build));
            }
            RunStatus {
                task,
                key: run.key.clone(),
                label: run.label.clone(),
                build: parts(&run.key).1.to_owned(),
                state,
                step,
                steps: run.steps,
                psnr,
                detail,
                other_builds,
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
        print_notes(&planned_by(&plan));
        Ok(())
    }
}

impl CollectArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (dir, plan) = self.planned.open()?;
        print_notes(&planned_by(&plan));
        report(&plan, &dir, self.any_build, self.json)
    }
}

/// Notes which build planned the sweep, if it is not this one.
fn planned_by(plan: &Plan) -> Vec<String> {
    let own = program::build().ok().filter(|own| own.digest != plan.build);
    let text = |own: &program::Build| {
        format!(
            "the sweep was last planned by {} of the program; this is {}",
            build_label(&plan.build),
            build_label(&own.digest)
        )
    };
    own.map(text).into_iter().collect()
}

fn print_notes(notes: &[String]) {
    notes.iter().for_each(|note| errln!("note: {note}"));
}

/// Writes the report of the finished runs; prints its table, or the results as JSON. Builds are mixed only if
/// `any_build` is set.
pub(super) fn report(plan: &Plan, dir: &Path, any_build: bool, json: bool) -> Result<(), CliError> {
    let view = view(plan, any_build);
    print_notes(&view.notes);
    let set = collect(&view.plan, dir);
    let text = write_report(dir, &set).map_err(CliError::failure)?;
    errln!("report: {}", dir.join("report.html").display());
    if json {
        return print_json(&set);
    }
    out!("{text}");
    Ok(())
}
