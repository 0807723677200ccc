//! The checkpoints of a run.

use super::beginning::Beginning;
use super::clock::RunClock;
use super::{RunOptions, TakenStep};
use crate::config::types::Config;
use crate::train::checkpoint::{self, CheckpointState};
use crate::train::resume::AVERAGE;
use crate::train::{TrainError, Training};
use std::path::Path;

/// Saves checkpoints at intervals and at the end.
#[derive(Debug)]
pub(super) struct Checkpointer<'a> {
    run: &'a Path,
    config_toml: &'a str,
    fingerprint: &'a str,
    /// Steps between checkpoints; 0 for only one at the end.
    every: usize,
    /// Number of checkpoints to keep.
    keep: usize,
    /// Steps taken before this process.
    first: usize,
    /// Whether the newest checkpoint is of the present state.
    is_saved: bool,
}

impl<'a> Checkpointer<'a> {
    /// Returns the checkpoints of a run that begins at `beginning`.
    pub(super) fn new(config: &Config, options: &'a RunOptions, beginning: &'a Beginning) -> Self {
        // without its average the scene is another, even if no step is left
        let is_dropped = config.optim.average == 0 && beginning.changes.iter().any(|change| change.key == AVERAGE);
        Self {
            run: &options.out,
            config_toml: &options.config_toml,
            fingerprint: &beginning.fingerprint,
            every: config.output.checkpoint_every,
            keep: config.output.keep,
            first: beginning.steps,
            is_saved: beginning.is_resumed && !is_dropped,
        }
    }

    /// Saves a checkpoint after a step, if one is due, and returns whether it did.
    ///
    /// # Errors
    /// If it cannot be written, or a moment is not finite.
    pub(super) fn after_step(&mut self, step: &TakenStep<'_>) -> Result<bool, TrainError> {
        self.is_saved = step.is_due(self.every);
        if self.is_saved {
            self.save(step.training, step.clock)?;
        }
        Ok(self.is_saved)
    }

    /// Saves the state at the end of the run, unless the newest checkpoint is of this state or no step was ever taken.
    ///
    /// # Errors
    /// As [`Checkpointer::after_step`].
    pub(super) fn finish(&self, training: &dyn Training, clock: &RunClock) -> Result<(), TrainError> {
        let steps = training.steps_done();
        if self.is_saved || steps == 0 {
            return Ok(());
        }
        self.save(training, clock)?;
        if steps == self.first {
            errln!("note: the scene of step {steps} has changed with {AVERAGE}; evaluate it again");
        }
        Ok(())
    }

    fn save(&self, training: &dyn Training, clock: &RunClock) -> Result<(), TrainError> {
        let state = CheckpointState {
            step: training.steps_done(),
            initial: training.first_primitives(),
            dataset: self.fingerprint.to_owned(),
            config: self.config_toml.to_owned(),
            seconds: clock.seconds(),
            packed: false,
        };
        checkpoint::save(self.run, training, &state, self.keep).map(drop).map_err(TrainError::Save)
    }
}
