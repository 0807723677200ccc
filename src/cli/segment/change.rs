//! `volseggs segment group`, `segment rename` and `segment remove`

use super::super::{CliError, Common, command_line, print_json};
use crate::files::Work;
use crate::name::Name;
use crate::run::OpenRun;
use crate::run::segments::RunSegments;
use clap::Args;
use std::path::PathBuf;

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
    common: Common,
}

impl GroupArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let run = OpenRun::open_to_write(&self.run, &device, &command_line(), Work::Short)?;
        let mut segments = RunSegments::open(&run)?;
        segments.group(&self.name, &self.segments)?;
        segments.save()?;
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
    common: Common,
}

impl RenameArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let run = OpenRun::open_to_write(&self.run, &device, &command_line(), Work::Short)?;
        let mut segments = RunSegments::open(&run)?;
        segments.rename(&run, &self.old, &self.new)?;
        segments.save()?;
        let names: Vec<&str> = segments.now().segments.iter().map(|s| s.name.as_str()).collect();
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
    common: Common,
}

impl RemoveArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let run = OpenRun::open_to_write(&self.run, &device, &command_line(), Work::Short)?;
        let mut segments = RunSegments::open(&run)?;
        let removed = segments.remove(&self.segments)?;
        segments.save()?;
        let left: Vec<&str> = segments.now().segments.iter().map(|s| s.name.as_str()).collect();
        if self.common.json {
            return print_json(&serde_json::json!({ "removed": removed, "segments": left }));
        }
        errln!("{removed} removed; left: {}", if left.is_empty() { "none".into() } else { left.join(", ") });
        Ok(())
    }
}
