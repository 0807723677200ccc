//! `volseggs segment group`, `segment rename` and `segment remove`

use super::super::{CliError, Common, print_json};
use super::{names, open_to_change};
use crate::name::Name;
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
        let (_run, mut segments) = open_to_change(&self.run, &self.common)?;
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
        let (run, mut segments) = open_to_change(&self.run, &self.common)?;
        segments.rename(&run, &self.old, &self.new)?;
        segments.save()?;
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
    common: Common,
}

impl RemoveArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_run, mut segments) = open_to_change(&self.run, &self.common)?;
        let removed = segments.remove(&self.segments)?;
        segments.save()?;
        let left = names(&segments);
        if self.common.json {
            return print_json(&serde_json::json!({ "removed": removed, "segments": left }));
        }
        errln!("{removed} removed; left: {}", if left.is_empty() { "none".into() } else { left.join(", ") });
        Ok(())
    }
}
