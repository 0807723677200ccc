//! Options of segmentation for one command, instead of those that a run was trained with.

use super::{OpenRun, RunError};
use crate::config::RESERVED_VARIABLES;
use crate::config::layers::Layers;
use crate::config::types::Config;

/// The section whose keys change no step of training.
const SEGMENT: &str = "segment.";

impl OpenRun {
    /// Resolves the section `[segment]` of the run's configuration again: the run's own values, the file or preset
    /// `source`, the environment, then `sets`, each `segment.KEY=VALUE`. Other sections stay as the run was trained.
    ///
    /// # Errors
    /// If a setting is of another section, unknown, or out of range.
    pub fn segmented_by(mut self, source: Option<&str>, sets: &[String]) -> Result<Self, RunError> {
        if let Some(other) = sets.iter().find(|set| !set.starts_with(SEGMENT)) {
            return Err(RunError::input(format!(
                "--set {other}: only keys that begin with `{SEGMENT}` can be set here; others shaped the training"
            )));
        }
        let layers = crate::method::layers().source(self.paths().config().to_string_lossy());
        let layers = source.into_iter().fold(layers, Layers::source);
        let layers = layers.env(std::env::vars_os(), RESERVED_VARIABLES).map_err(RunError::input)?;
        let found = layers.sets(sets).resolve::<Config>().map_err(RunError::input)?.value.segment;
        found.check().map_err(RunError::input)?;
        self.config.segment = found;
        Ok(self)
    }
}
