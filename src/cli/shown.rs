//! Command-line options for which parts of a scene are shown.

use super::CliError;
use crate::run::OpenRun;
use crate::run::selection::Selection;
use clap::Args;

/// Which parts of a scene to show.
#[derive(Debug, Clone, Args)]
pub(super) struct ShownArgs {
    /// Show only this segment; may be repeated.
    #[arg(long = "segment", value_name = "NAME")]
    pub segments: Vec<String>,
    /// Ignore the edits of the run.
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
    /// If no segment has a given name, or a file is damaged.
    pub(super) fn select(&self, run: &OpenRun) -> Result<Selection, CliError> {
        Ok(Selection::open(run, &self.segments, !self.no_edits)?)
    }
}
