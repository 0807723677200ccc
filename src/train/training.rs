//! A training that is under way, whichever method it is of: what [`super::run`] drives and checkpoints keep.

use super::checkpoint::CheckpointError;
use super::{StepReport, TrainError};
use crate::data::Split;
use crate::model::Model;
use crate::model::params::HostTensor;
use std::collections::BTreeMap;
use std::path::Path;

/// A training that is under way.
///
/// A step depends on the seed, the step and the data alone: whoever stops after any step, saves, starts anew and resumes
/// gets the same bits (on a CPU) as without the stop.
pub trait Training {
    /// Steps of the whole training, by its configuration.
    fn total_steps(&self) -> usize;

    /// Steps taken, those before a resume with them.
    fn steps_done(&self) -> usize;

    /// Takes one step on the training views, always the same ones: the 8-bit images with alpha of `split.images`, in the
    /// order of `split.frames`.
    ///
    /// # Errors
    /// [`TrainError::NotFinite`] at the first NaN or infinity, naming it; [`super::watch::LossWatch`] looks at the loss,
    /// [`super::optimizer::Optimizer`] at gradients and parameters.
    fn step(&mut self, split: &Split) -> Result<StepReport, TrainError>;

    /// What it is making, as it stands.
    fn model(&self) -> &dyn Model;

    /// What a checkpoint needs beside the model, by name: moments, statistics, networks that only training has.
    fn state(&self) -> BTreeMap<String, HostTensor>;

    /// Goes on from a checkpoint of a training that was started with the same configuration and data.
    ///
    /// # Errors
    /// If the checkpoint's files are damaged or do not fit.
    fn resume(&mut self, from: Saved<'_>) -> Result<(), CheckpointError>;

    /// Primitives that the training began with, if what is due at a step follows from it.
    fn first_primitives(&self) -> usize {
        0
    }
}

/// A checkpoint as a training takes it back.
#[derive(Debug)]
pub struct Saved<'a> {
    /// The file that [`Model::save`] wrote.
    pub model: &'a Path,
    /// What [`Training::state`] gave.
    pub state: BTreeMap<String, HostTensor>,
    /// The file that it was read from, for messages.
    pub state_path: &'a Path,
    /// Steps taken.
    pub step: usize,
    /// What [`Training::first_primitives`] gave.
    pub first_primitives: usize,
}
