//! `volseggs sweep`

mod devices;
mod results;
mod start;
mod worker;

use super::CliError;
use crate::shell;
use crate::sweep::{Plan, file::name_of, plan::FOLDER};
use clap::{Args, Subcommand};
use std::path::{Path, PathBuf};

/// Run an ablation or a sweep: turn one file into runs, on this machine or on Slurm, and one table.
#[derive(Debug, Args)]
#[command(
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    after_help = "Examples:\n  volseggs sweep configs/ablations/loss-small.toml --dry-run   # runs, differences, time and memory\n  volseggs sweep configs/ablations/loss-small.toml --jobs 2    # the same command resumes\n  volseggs sweep configs/ablations/loss-small.toml --data DATASET    # on your own images\n  volseggs sweep my.toml --synthetic size=32 --set output.max_minutes=0.05 --out trial    # a trial in seconds\n  volseggs sweep my.toml --only 'L1' --rerun-failed\n  volseggs sweep my.toml --slurm --profile cluster.toml        # one job array; then:\n  volseggs sweep status my.toml\n  volseggs sweep collect my.toml                               # the report, from the runs done so far\n  volseggs sweep devices --data DATASET --config quick         # the same training on every device\n\nRuns are stored in OUT/runs/KEY, keyed by configuration, dataset, device, version\nand build of the program, and are shared by all sweeps in OUT. A rebuilt program trains again; --any-build takes over\nwhat other builds finished.\nThe report is in OUT/NAME: report.html, report.md, table.tex, results.csv, results.json, tensorboard/."
)]
pub struct SweepArgs {
    #[command(subcommand)]
    action: Option<SweepAction>,
    #[command(flatten)]
    start: start::StartArgs,
}

#[derive(Debug, Subcommand)]
enum SweepAction {
    /// Show the progress of the runs, here and in Slurm's queue.
    Status(results::StatusArgs),
    /// Make the report from the runs done so far.
    Collect(results::CollectArgs),
    /// Do one run of a planned sweep (called by `sweep` and by Slurm tasks).
    Worker(worker::WorkerArgs),
    /// Train the same configuration on every device and compare speed, quality and the drift of the parameters.
    Devices(devices::DevicesArgs),
}

impl SweepArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        match self.action {
            Some(SweepAction::Status(args)) => args.run(),
            Some(SweepAction::Collect(args)) => args.run(),
            Some(SweepAction::Worker(args)) => args.run(),
            Some(SweepAction::Devices(args)) => args.run(),
            None => self.start.run(),
        }
    }
}

/// A sweep that has already been planned.
#[derive(Debug, Args)]
struct Planned {
    /// Sweep file, or the sweep's folder.
    #[arg(value_name = "FILE")]
    sweep: PathBuf,
    /// Folder of sweeps, as given when the sweep was started.
    #[arg(long, default_value = FOLDER, value_name = "OUT")]
    out: PathBuf,
}

impl Planned {
    /// The sweep's folder and its plan.
    fn open(&self) -> Result<(PathBuf, Plan), CliError> {
        let dir =
            if self.sweep.join("plan.json").is_file() { self.sweep.clone() } else { folder(&self.out, &self.sweep) };
        let plan = Plan::load(&dir, None).map_err(|e| {
            CliError::input(format!("{e}; start it with `volseggs sweep {}`", shell::path(&self.sweep)))
        })?;
        Ok((dir, plan))
    }
}

/// The folder of the sweep defined by `file`.
fn folder(out: &Path, file: &Path) -> PathBuf {
    out.join(name_of(file))
}
