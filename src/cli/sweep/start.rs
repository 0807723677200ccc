//! `volseggs sweep FILE`: plan, then run here or submit to Slurm.

use super::{CliError, folder, results};
use crate::cli::values::count;
use crate::cli::{print_json, stop_flag};
use crate::durations::duration;
use crate::metrics::METRICS;
use crate::metrics::metric::Networks;
use crate::program::{self, short};
use crate::shell;
use crate::sweep::builds::{OtherBuilds, tally};
use crate::sweep::estimate::estimate;
use crate::sweep::local::{self, LocalOptions};
use crate::sweep::result::{RunCompletion, failure_path, progress};
use crate::sweep::slurm::{SlurmJob, SlurmProfile, SlurmTools, queue, submit};
use crate::sweep::{Plan, PlanOptions};
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub(super) struct StartArgs {
    /// Sweep file (TOML); see configs/ablations, configs/sweeps and docs/sweeps.md.
    #[arg(required = true, value_name = "FILE")]
    file: Option<PathBuf>,
    /// Number of concurrent processes on this machine; they share its cores.
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = count)]
    jobs: usize,
    #[command(flatten)]
    plan: PlanOptions,
    /// Do only runs whose name contains this text or whose key starts with it; may be repeated.
    #[arg(long, value_name = "TEXT")]
    only: Vec<String>,
    /// Retry failed runs.
    #[arg(long)]
    rerun_failed: bool,
    /// Use runs finished by other builds of the program instead of training them again; missing measurements are made
    /// by this build.
    #[arg(long)]
    any_build: bool,
    /// Show the runs, their differences and their estimated cost; start nothing.
    #[arg(long)]
    dry_run: bool,
    /// Submit to Slurm as one job array, instead of running here.
    #[arg(long)]
    slurm: bool,
    /// Slurm settings: partition, time, memory, modules and so on (TOML; see configs/slurm.toml).
    #[arg(long, value_name = "FILE", requires = "slurm")]
    profile: Option<PathBuf>,
    /// Print one JSON object on standard output; logs stay on standard error.
    #[arg(long)]
    json: bool,
}

/// Notes that the report in `dir` will be of other data than before. The runs of both are kept.
fn note_other_data(plan: &Plan, dir: &Path) {
    let folders = |plan: &Plan| plan.datasets.values().map(|data| data.folder.clone()).collect::<Vec<_>>();
    if let Ok(before) = Plan::load(dir, None)
        && folders(&before) != folders(plan)
    {
        errln!(
            "note: the report in {} covers other data ({}) and will be replaced; all runs are kept; use another \
             --out to keep both reports",
            dir.display(),
            before.datasets.keys().cloned().collect::<Vec<_>>().join(", ")
        );
    }
}

impl StartArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let file = self.file.clone().ok_or_else(|| CliError::input("give a sweep file"))?;
        let out = absolute(&self.plan.out, "--out")?;
        if out.exists() && !out.is_dir() {
            return Err(CliError::input(format!("--out {}: is a file; give a folder", out.display())));
        }
        let weights = self.plan.lpips_weights.iter().map(|path| absolute(path, "--lpips-weights"));
        let lpips_weights = weights.collect::<Result<_, _>>()?;
        let options = PlanOptions { out: out.clone(), lpips_weights, elsewhere: self.slurm, ..self.plan.clone() };
        let mut plan = Plan::new(&file, &options)?;
        let needs_weights = |name: &String| METRICS.get(name).is_ok_and(|m| !m.is_available(&Networks::default()));
        if plan.metrics.iter().any(needs_weights) && plan.eval.lpips_weights.is_empty() {
            errln!("note: no LPIPS without --lpips-weights FILE (or eval.lpips_weights in the sweep file)");
        }
        let dir = folder(&out, &file);
        let runs = self.choose(&plan)?;
        self.other_builds(&mut plan, &runs);
        if self.dry_run {
            return self.show(&plan, &runs);
        }
        if plan.halving.is_some() && self.slurm {
            return Err(CliError::input(format!(
                "{}: halving waits for all runs at each rung, which a job array cannot do; omit --slurm or [halving]",
                file.display()
            )));
        }
        // read before anything is written
        let profile = self.profile.as_deref().map(SlurmProfile::read).transpose()?.unwrap_or_default();
        let stop = stop_flag("stopping; runs save checkpoints first")?;
        note_other_data(&plan, &dir);
        let hash = plan.save(&dir)?;
        if self.rerun_failed {
            for &run in &runs {
                let _ = std::fs::remove_file(failure_path(&plan.run_folder(run)));
            }
        }
        let used = |name: &str| runs.iter().any(|run| plan.runs[*run].dataset == name);
        for (_, data) in plan.datasets.iter().filter(|(name, _)| used(name)) {
            data.make(&stop)?;
        }
        if self.slurm {
            return self.submit(&plan, (&dir, &hash), &runs, profile);
        }
        let options =
            LocalOptions { dir: dir.clone(), plan: hash, jobs: self.jobs, runs, program: program::executable() };
        let tally = local::run(&plan, &options, &stop)?;
        results::report(&plan, &dir, false, self.json)?;
        if tally.failed + tally.died > 0 {
            return Err(CliError::failure(format!(
                "{} runs failed, {} died; logs are in {}; the same command resumes, --rerun-failed retries failed runs",
                tally.failed,
                tally.died,
                dir.join("logs").display()
            )));
        }
        Ok(())
    }

    /// Reports the chosen runs that other builds finished; takes over all of them if requested.
    fn other_builds(&self, plan: &mut Plan, runs: &[usize]) {
        let all: Vec<usize> = (0..plan.runs.len()).collect();
        let found = OtherBuilds::find(plan).replacements(plan, if self.any_build { &all } else { runs });
        let (n, of) = (found.len(), tally(found.values()));
        let (one, is) = if n == 1 { ("run", "is") } else { ("runs", "are") };
        match (n, self.any_build) {
            (0, _) => {}
            (_, true) => {
                plan.replace_runs(&found);
                errln!("{n} {one} finished by other builds of the program ({of}) {is} taken over");
            }
            (_, false) => errln!(
                "note: {n} {one} finished by another build of the program ({of}) {is} trained again by this one ({}); \
                 --any-build takes over finished runs",
                short(&plan.build)
            ),
        }
    }

    /// The runs selected by `--only`.
    fn choose(&self, plan: &Plan) -> Result<Vec<usize>, CliError> {
        let wanted = |i: &usize| {
            let run = &plan.runs[*i];
            let of_it = plan.entries.iter().filter(|e| e.run == *i);
            let names: Vec<&str> = of_it.map(|e| e.variant.as_str()).collect();
            let has = |text: &String| {
                run.label.contains(text) || run.key.starts_with(text) || names.iter().any(|n| n.contains(text))
            };
            self.only.is_empty() || self.only.iter().any(has)
        };
        let runs: Vec<usize> = (0..plan.runs.len()).filter(wanted).collect();
        if runs.is_empty() {
            let labels: Vec<&str> = plan.runs.iter().take(8).map(|r| r.label.as_str()).collect();
            let text = format!("--only {}: no run matches; available: {}, ...", self.only.join(" "), labels.join(", "));
            return Err(CliError::input(text));
        }
        Ok(runs)
    }

    fn show(&self, plan: &Plan, runs: &[usize]) -> Result<(), CliError> {
        let total = estimate(plan, runs, self.jobs, self.rerun_failed);
        if self.json {
            #[derive(Serialize)]
            struct Shown<'a> {
                plan: &'a Plan,
                open_runs: usize,
                seconds: f64,
                memory_bytes: f64,
            }
            let shown = Shown { plan, open_runs: total.open, seconds: total.seconds, memory_bytes: total.memory };
            return print_json(&shown);
        }
        outln!("{}: {} entries, {} runs", plan.title, plan.entries.len(), plan.runs.len());
        for (name, data) in &plan.datasets {
            let there = if data.folder.is_dir() { "" } else { ", to be rendered" };
            let [w, h] = data.size;
            outln!("data {name}: {} ({} views of {w}x{h}{there})", data.folder.display(), data.views);
        }
        let width = plan.runs.iter().map(|r| r.label.len()).max().unwrap_or(0).min(60);
        for &i in runs {
            let run = &plan.runs[i];
            let state = match progress(plan, i) {
                RunCompletion::Done => "done",
                RunCompletion::Failed(_) if self.rerun_failed => "retry",
                RunCompletion::Failed(_) => "failed",
                RunCompletion::Open => "to do",
            };
            let entries: Vec<_> = plan.entries.iter().filter(|e| e.run == i).collect();
            let difference = |e: &&crate::sweep::PlanEntry| {
                let all: Vec<String> = e.settings.iter().map(|(k, v)| format!("{k} = {v}")).collect();
                if all.is_empty() { "the base".to_owned() } else { all.join(", ") }
            };
            let differences: Vec<String> = entries.iter().map(difference).collect();
            outln!("{} {:width$} {state:6} {}", run.key, run.label, differences.join(" | "));
        }
        outln!(
            "remaining: {} runs, about {} with --jobs {}, {:.1} GB of memory (measured times so far: {:.2} of the \
             model's)",
            total.open,
            duration(total.seconds),
            self.jobs,
            total.memory / 1e9,
            total.correction
        );
        Ok(())
    }

    fn submit(
        &self,
        plan: &Plan,
        (dir, hash): (&Path, &str),
        runs: &[usize],
        profile: SlurmProfile,
    ) -> Result<(), CliError> {
        let tools = SlurmTools::default();
        let job = SlurmJob { plan: hash.to_owned(), ..SlurmJob::new(dir, profile)? };
        let queued = if tools.have("squeue") { queue(&tools, dir, hash)? } else { Default::default() };
        let open = |i: &usize| progress(plan, *i) == RunCompletion::Open && !queued.contains_key(i);
        let tasks: Vec<usize> = runs.iter().copied().filter(open).collect();
        if tasks.is_empty() {
            errln!("nothing to submit: {} runs are done, failed or in the queue", runs.len());
        }
        let started = std::time::Instant::now();
        let jobs = if tasks.is_empty() { Vec::new() } else { submit(&tools, &job, &tasks)? };
        for j in &jobs {
            errln!("job {}: {} tasks", j.job, j.tasks.len());
        }
        if !jobs.is_empty() {
            errln!(
                "submitted in {:.2} s; script: {}; next: volseggs sweep status {}",
                started.elapsed().as_secs_f64(),
                job.file().display(),
                shell::path(dir)
            );
        }
        if self.json { print_json(&serde_json::json!({ "jobs": jobs })) } else { Ok(()) }
    }
}

/// The path given with `option`, from the root.
fn absolute(path: &Path, option: &str) -> Result<PathBuf, CliError> {
    std::path::absolute(path).map_err(|e| CliError::input(format!("{option} {}: {e}", path.display())))
}
