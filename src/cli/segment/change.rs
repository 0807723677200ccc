//! `volseggs segment group`, `segment rename`, `segment remove`, `segment undo` and `segment redo`

use super::super::values::count;
use super::super::{CliError, CommonArgs, print_json};
use crate::files::LockDuration;
use crate::name::Name;
use crate::run::segments::{HistoryDirection, RunSegments};
use crate::run::{OpenRun, RunError};
use clap::Args;
use std::path::{Path, PathBuf};

/// Changes the segments of a run and saves them. Returns them with what `change` returned.
fn change<T>(
    run: &Path,
    common: &CommonArgs,
    change: impl FnOnce(&OpenRun, &mut RunSegments) -> Result<T, RunError>,
) -> Result<(RunSegments, T), CliError> {
    let run = common.open_to_write(run, LockDuration::Short)?;
    let mut segments = RunSegments::open(&run)?;
    let found = change(&run, &mut segments)?;
    segments.save()?;
    Ok((segments, found))
}

fn names(segments: &RunSegments) -> Vec<&str> {
    segments.now().segments.iter().map(|s| s.name.as_str()).collect()
}

/// Names as they are printed.
fn list(names: &[&str]) -> String {
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// Group segments under a new name.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  volseggs segment group RUN pair red.1 red.2")]
pub struct GroupArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Name of the group.
    name: Name,
    /// Segments of the group; they are kept as they are.
    #[arg(required = true)]
    segments: Vec<String>,
    #[command(flatten)]
    common: CommonArgs,
}

impl GroupArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (segments, ()) = change(&self.run, &self.common, |_, segments| segments.group(&self.name, &self.segments))?;
        let group = segments.now().get(&self.name).map_err(CliError::failure)?;
        if self.common.json {
            return print_json(&serde_json::json!({ "name": group.name, "gaussians": group.members.len() }));
        }
        outln!("{:20} {:>8} Gaussians", group.name, group.members.len());
        Ok(())
    }
}

/// Rename a segment; its edits follow the new name, and its parts keep theirs.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  volseggs segment rename RUN red core\n\n`volseggs segment undo RUN` restores the old name. A track in RUN/track/ that is named after the segment must be moved first."
)]
pub struct RenameArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Current name of the segment.
    old: String,
    /// New name of the segment.
    new: Name,
    #[command(flatten)]
    common: CommonArgs,
}

impl RenameArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (segments, ()) =
            change(&self.run, &self.common, |run, segments| segments.rename(run, &self.old, &self.new))?;
        let names = names(&segments);
        if self.common.json {
            return print_json(&serde_json::json!({ "old": self.old, "name": self.new, "segments": names }));
        }
        errln!("{} is now called {}; segments: {}", self.old, self.new, names.join(", "));
        Ok(())
    }
}

/// Remove segments with their parts; the Gaussians are kept.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  volseggs segment remove RUN pair red.2\n\n`volseggs segment undo RUN` restores them."
)]
pub struct RemoveArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Segments to remove.
    #[arg(required = true)]
    segments: Vec<String>,
    #[command(flatten)]
    common: CommonArgs,
}

impl RemoveArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (segments, removed) = change(&self.run, &self.common, |_, segments| segments.remove(&self.segments))?;
        let left = names(&segments);
        if self.common.json {
            return print_json(&serde_json::json!({ "removed": removed, "segments": left }));
        }
        errln!("{removed} removed; left: {}", list(&left));
        Ok(())
    }
}

#[derive(Debug, Args)]
pub struct StepArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Number of changes.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = count)]
    count: usize,
    #[command(flatten)]
    common: CommonArgs,
}

impl StepArgs {
    /// Undoes or redoes changes, which is `done` to them.
    pub(super) fn run(self, towards: HistoryDirection, done: &str) -> Result<(), CliError> {
        let (segments, steps) = change(&self.run, &self.common, |_, segments| segments.step(towards, self.count))?;
        let names = names(&segments);
        if self.common.json {
            return print_json(&serde_json::json!({
                done: steps, "segments": names,
                "undo": segments.steps(HistoryDirection::Undo), "redo": segments.steps(HistoryDirection::Redo),
            }));
        }
        for step in &steps {
            outln!("{done}: {step}");
        }
        errln!("segments: {}", list(&names));
        Ok(())
    }
}
