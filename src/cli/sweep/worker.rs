//! `volseggs sweep worker`: does one run in this process.

use super::CliError;
use crate::cli::{OnSecondSignal, stop_flag_with};
use crate::program::{build, build_label};
use crate::sweep::Plan;
use crate::sweep::local::{HELD, INTERRUPTED};
use crate::sweep::work::{RunEnd, work};
use clap::Args;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

/// Do one run; exits with 0 if it is done (or was already, or another process has it), with 75 if it was interrupted,
/// or the run is in use, and it should be called again.
#[derive(Debug, Args)]
pub(super) struct WorkerArgs {
    /// Folder of the sweep, with plan.json.
    dir: PathBuf,
    /// Number of the run in the plan, from 0.
    #[arg(long, value_name = "N")]
    task: usize,
    /// Hash of the plan (plans/HASH.json); the newest if not given.
    #[arg(long, value_name = "HASH")]
    plan: Option<String>,
    /// Pause training after this many steps in total.
    #[arg(long, value_name = "STEPS")]
    stop_after: Option<usize>,
    /// Stop when this process ends.
    #[arg(long, value_name = "PID", hide = true)]
    parent: Option<u32>,
}

impl WorkerArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let mut plan = Plan::load(&self.dir, self.plan.as_deref())?;
        let (own, planned) = (build().map_err(CliError::failure)?, plan.build.clone());
        if plan.hand_over(&own.digest) {
            errln!(
                "note: planned by {} of the program, run by {}; the run counts as one of the latter",
                build_label(&planned),
                build_label(&own.digest)
            );
        }
        let Some(run) = plan.runs.get(self.task) else {
            return Err(CliError::input(format!(
                "--task {}: the plan has {} runs, numbered from 0",
                self.task,
                plan.runs.len()
            )));
        };
        let stop = stop_flag_with("stopping after this step, with a checkpoint", OnSecondSignal::Ignore)?;
        if let Some(parent) = self.parent {
            end_with(parent, &stop);
        }
        errln!("run {} of {}: {} ({})", self.task, plan.runs.len(), run.label, run.key);
        let ended = work(&plan, self.task, self.stop_after, &stop);
        match ended.map_err(|e| CliError::failure(format!("{}: {e}", plan.run_folder(self.task).display())))? {
            RunEnd::Done => errln!("done"),
            RunEnd::AlreadyDone => errln!("already done"),
            RunEnd::Paused => errln!("paused"),
            RunEnd::Held(holder) => {
                errln!("{holder} holds this run");
                // a sweep on this machine tries again later; a Slurm task is not needed
                if self.parent.is_some() {
                    return Err(CliError::with_code("another process holds this run", HELD));
                }
            }
            RunEnd::Busy(holder) => {
                let code = if self.parent.is_some() { HELD } else { INTERRUPTED };
                return Err(CliError::with_code(format!("in use by {holder}; try again later"), code));
            }
            RunEnd::Interrupted => return Err(CliError::with_code("interrupted, with a checkpoint", INTERRUPTED)),
            RunEnd::Failed(error) => return Err(CliError::failure(error)),
        }
        Ok(())
    }
}

/// Requests that this process be asked to stop when process `parent` ends.
fn end_with(parent: u32, stop: &AtomicBool) {
    #[cfg(target_os = "linux")]
    {
        use rustix::process::{Signal, getppid, set_parent_process_death_signal};
        let _ = set_parent_process_death_signal(Some(Signal::TERM));
        // the parent may have ended already
        if getppid().map(|p| p.as_raw_nonzero().get().unsigned_abs()) != Some(parent) {
            stop.store(true, std::sync::atomic::Ordering::Relaxed);
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = (parent, stop);
}
