//! `volseggs segment list`

use super::super::run_folder::RunFolder;
use super::super::{CliError, Common, print_json};
use clap::Args;
use std::path::PathBuf;

/// The segments of a run, parts under their wholes.
#[derive(Debug, Args)]
pub struct ListArgs {
    /// Folder of the run.
    run: PathBuf,
    #[command(flatten)]
    common: Common,
}

impl ListArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let all = RunFolder::open(&self.run, &device)?.segments()?;
        if self.common.json {
            return print_json(&all);
        }
        for (segment, depth) in all.segments.iter().zip(all.depths()) {
            let name = format!("{:width$}{}", "", segment.name, width = 2 * depth);
            outln!("{name:30} {:>8} Gaussians  found at {:.3}", segment.members.len(), segment.time);
        }
        Ok(())
    }
}
