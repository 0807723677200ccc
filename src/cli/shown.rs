//! What of a scene is shown, as it is typed.

use super::CliError;
use crate::run::OpenRun;
use crate::run::selection::Selection;
use clap::Args;

/// What of a scene to show.
#[derive(Debug, Clone, Args)]
pub(super) struct ShownArgs {
    /// Show this segment alone; may be given many times.
    #[arg(long = "segment", value_name = "NAME")]
    pub segments: Vec<String>,
    /// Leave out the edits of the run.
    #[arg(long)]
    pub no_edits: bool,
}

impl ShownArgs {
    /// The first option that was given.
    pub(super) fn given(&self) -> Option<&'static str> {
        let segments = (!self.segments.is_empty()).then_some("--segment");
        segments.or(self.no_edits.then_some("--no-edits"))
    }

    /// Reads the run's segments and edits.
    ///
    /// # Errors
    /// A name that no segment has, or a file that is damaged.
    pub(super) fn select(&self, run: &OpenRun) -> Result<Selection, CliError> {
        Ok(Selection::open(run, &self.segments, !self.no_edits)?)
    }
}
