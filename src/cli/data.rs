//! The place of a run's dataset, shared by every command that may read it.

use super::CliError;
use crate::run::{OpenRun, TrainedModel};
use clap::Args;
use std::path::PathBuf;

/// Where the dataset of a run is.
#[derive(Debug, Clone, Args)]
pub(super) struct DataArgs {
    /// The dataset that the run was trained on, if it was moved without the run (`volseggs relocate` records the new
    /// place).
    #[arg(long, value_name = "DATASET")]
    pub data: Option<PathBuf>,
}

impl DataArgs {
    /// Returns `run` with the dataset at the given place, if one is given.
    ///
    /// # Errors
    /// If the folder does not hold the dataset that the run was trained on.
    pub(super) fn apply_to<S: TrainedModel>(&self, run: OpenRun<S>) -> Result<OpenRun<S>, CliError> {
        Ok(run.with_dataset(self.data.as_deref())?)
    }
}
