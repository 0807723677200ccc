//! Observers of a run while it trains, which may pause it between two steps.
//!
//! No step depends on what an observer does: it sees the model but cannot change it, and the training draws no random
//! numbers on its account.

use super::StepReport;
use super::record::RunRecord;
use crate::config::types::Config;
use crate::model::Model;
use std::path::Path;

/// Progress of a run.
#[derive(Clone, Copy, Debug)]
pub struct RunProgress<'a> {
    /// Folder of the run.
    pub run: &'a Path,
    /// Its configuration.
    pub config: &'a Config,
    /// Its record, as last written.
    pub record: &'a RunRecord,
    /// The model being trained, on the training device.
    pub model: &'a dyn Model,
    /// Steps taken, including those before a resume.
    pub steps: usize,
    /// Number of steps at which this training ends.
    pub until: usize,
    /// Seconds of training, excluding pauses.
    pub seconds: f64,
    /// The last step; `None` before the first.
    pub report: Option<StepReport>,
}

/// What a training does next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrainingAction {
    /// Takes the next step.
    Continue,
    /// Waits; the observer is asked again.
    Pause,
}

/// Watches a run while it trains.
pub trait Observer {
    /// Called before the first step, after every step, and repeatedly during a pause; the training waits for it. After
    /// the last step there is no pause.
    fn on_step(&mut self, now: &RunProgress<'_>) -> TrainingAction;
}
