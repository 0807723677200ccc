//! `volseggs segment group` and `segment remove`

use super::super::run_folder::RunFolder;
use super::super::{CliError, Common, print_json};
use super::history::History;
use crate::files::Work;
use crate::name::Name;
use crate::segment::segmentation::{Origin, Segment};
use clap::Args;
use std::path::PathBuf;

/// Several segments as one, under a name of its own.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  volseggs segment group RUN pair red.1 red.2")]
pub struct GroupArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Name of the group.
    name: Name,
    /// Its segments, which stay as they are.
    #[arg(required = true)]
    segments: Vec<String>,
    #[command(flatten)]
    common: Common,
}

impl GroupArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let run = RunFolder::open_to_write(&self.run, &device, Work::Short)?;
        let mut history = History::open(&run)?;
        let mut all = history.now().clone();
        let found = self.segments.iter().map(|s| all.get(s)).collect::<Result<Vec<_>, _>>().map_err(CliError::input)?;
        let members: Vec<u32> = found.iter().flat_map(|s| &s.members).copied().collect();
        let (colour, time) = found.first().map_or(([0.5; 3], 0.5), |s| (s.colour, s.time));
        let group = Segment { name: self.name.clone(), parent: None, colour, time, origin: Origin::Group, members };
        if group.members.is_empty() {
            return Err(CliError::input(format!("{}: these segments hold no Gaussians", self.name)));
        }
        all.add(group).map_err(CliError::input)?;
        history.change(format!("group {}", self.name), all.segments.clone());
        history.save()?;
        let group = all.get(&self.name).map_err(CliError::failure)?;
        if self.common.json {
            return print_json(&serde_json::json!({ "name": group.name, "gaussians": group.members.len() }));
        }
        outln!("{:20} {:>8} Gaussians", group.name, group.members.len());
        Ok(())
    }
}

/// Remove segments with their parts; the Gaussians stay.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  volseggs segment remove RUN pair red.2\n\n`volseggs segment undo RUN` brings them back."
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
        let run = RunFolder::open_to_write(&self.run, &device, Work::Short)?;
        let mut history = History::open(&run)?;
        let mut all = history.now().clone();
        for name in &self.segments {
            all.get(name).map_err(CliError::input)?;
        }
        let before = all.segments.len();
        all.remove(|s| self.segments.iter().any(|n| s.name == *n));
        history.change(format!("remove {}", self.segments.join(" ")), all.segments.clone());
        history.save()?;
        let left: Vec<&str> = all.segments.iter().map(|s| s.name.as_str()).collect();
        if self.common.json {
            return print_json(&serde_json::json!({ "removed": before - left.len(), "segments": left }));
        }
        errln!(
            "{} removed; left: {}",
            before - left.len(),
            if left.is_empty() { "none".into() } else { left.join(", ") }
        );
        Ok(())
    }
}
