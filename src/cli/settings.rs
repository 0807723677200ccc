//! `--config` and `--set` of commands that segment: options of segmentation instead of those of the run.

use super::CliError;
use crate::run::OpenRun;
use clap::Args;

/// Options of segmentation. Each option of a command that has a key sets that key, after these.
#[derive(Debug, Clone, Args)]
pub(super) struct SegmentSettings {
    /// File or preset whose section [segment] applies instead of the run's.
    #[arg(long, value_name = "FILE")]
    config: Option<String>,
    /// Set an option of segmentation for this command; `volseggs config show` lists them. May be repeated.
    #[arg(long, value_name = "segment.KEY=VALUE")]
    set: Vec<String>,
}

impl SegmentSettings {
    /// Returns the flag that was given, if any.
    pub(super) fn given(&self) -> Option<&'static str> {
        let config = self.config.as_ref().map(|_| "--config");
        config.or((!self.set.is_empty()).then_some("--set"))
    }

    /// Returns the run with these options.
    ///
    /// # Errors
    /// If one is unknown or out of range.
    pub(super) fn apply_to(&self, run: OpenRun) -> Result<OpenRun, CliError> {
        Ok(run.segmented_by(self.config.as_deref(), &self.set)?)
    }
}

/// Sets a key to the value of an option, if that was given.
pub(super) fn set_if_given<T>(key: &mut T, given: Option<T>) {
    if let Some(value) = given {
        *key = value;
    }
}
