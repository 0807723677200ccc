//! `volseggs relocate`

use super::{CliError, CommonArgs, command_line, print_json};
use crate::files::LockDuration;
use crate::run::AnyRun;
use crate::run::relocate::relocate;
use crate::versioned::Versioned;
use clap::Args;
use std::path::PathBuf;

/// Record where the dataset of a run is after it was moved.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  volseggs relocate RUN --data DATASET\n\nA run and a dataset that are moved together find each other without it. The dataset must be the one that the run was trained on."
)]
pub struct RelocateArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Folder of the dataset that it was trained on.
    #[arg(long, value_name = "DATASET")]
    data: PathBuf,
    #[command(flatten)]
    common: CommonArgs,
}

impl RelocateArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let run = AnyRun::open_locked(&self.run, &device, &command_line(), LockDuration::Short)?;
        let run = relocate(run, &self.data)?;
        if self.common.json {
            return print_json(&Versioned::new(&run.record));
        }
        errln!("{}: the dataset is {}", run.path.display(), run.record.dataset.display());
        Ok(())
    }
}
