//! A training in progress, of any method: what [`super::run`] drives and checkpoints keep.

use super::checkpoint::CheckpointError;
use super::{StepReport, TrainError};
use crate::data::Split;
use crate::model::Model;
use crate::model::params::HostTensor;
use std::collections::BTreeMap;
use std::path::Path;

/// A training in progress.
///
/// A step depends on the seed, the step and the data alone: stopping after any step, saving, starting anew and resuming
/// gives the same bits (on a CPU) as not stopping.
pub trait Training {
    /// Steps of the whole training, from its configuration.
    fn total_steps(&self) -> usize;

    /// Steps taken, including those before a resume.
    fn steps_done(&self) -> usize;

    /// Takes one step on the training views, which are the same at every step: the 8-bit images with alpha of
    /// `split.images`, in the order of `split.frames`.
    ///
    /// # Errors
    /// [`TrainError::NotFinite`] at the first NaN or infinity, naming it; [`super::watch::LossWatch`] checks the loss,
    /// [`super::optimizer::Optimizer`] gradients and parameters.
    fn step(&mut self, split: &Split) -> Result<StepReport, TrainError>;

    /// Returns the model in its present state.
    fn model(&self) -> &dyn Model;

    /// Returns what a checkpoint needs besides the model, by name: moments, statistics, networks used only in training.
    fn state(&self) -> BTreeMap<String, HostTensor>;

    /// Resumes from a checkpoint of a training that was started with the same configuration and data.
    ///
    /// # Errors
    /// If the checkpoint's files are damaged or do not fit.
    fn resume(&mut self, from: SavedTraining<'_>) -> Result<(), CheckpointError>;

    /// Primitives at the start of the training, if what is due at a step depends on them.
    fn first_primitives(&self) -> usize {
        0
    }
}

/// A checkpoint to resume from.
#[derive(Debug)]
pub struct SavedTraining<'a> {
    /// The file that [`Model::save`] wrote.
    pub model: &'a Path,
    /// What [`Training::state`] returned.
    pub state: BTreeMap<String, HostTensor>,
    /// The file it was read from, for messages.
    pub state_path: &'a Path,
    /// Steps taken.
    pub step: usize,
    /// What [`Training::first_primitives`] returned.
    pub first_primitives: usize,
}
