//! [`Trainer`] as a [`Training`]: what a checkpoint keeps of it, and how it resumes from one.

use super::checkpoint::CheckpointError;
use super::densify::Statistics;
use super::due::PendingDensification;
use super::{InPlace, SavedTraining, StepReport, TrainError, Trainer, Training};
use crate::data::Split;
use crate::model::params::{self, HostTensor};
use crate::model::{Model, Scene};
use std::collections::BTreeMap;

impl Training for Trainer {
    fn total_steps(&self) -> usize {
        Trainer::total_steps(self)
    }

    fn steps_done(&self) -> usize {
        Trainer::steps_done(self)
    }

    fn step(&mut self, split: &Split) -> Result<StepReport, TrainError> {
        Trainer::step(self, split)
    }

    fn model(&self) -> &dyn Model {
        self.shown()
    }

    fn state(&self) -> BTreeMap<String, HostTensor> {
        let mut tensors = self.optimizer.to_tensors();
        tensors.extend(self.culling.to_tensors());
        tensors.extend(self.statistics.to_host().into_tensors());
        tensors.extend(self.ema.to_tensors(self.scene()));
        tensors.extend(self.pending.to_tensors());
        tensors
    }

    fn resume(&mut self, from: SavedTraining<'_>) -> Result<(), CheckpointError> {
        let bad = |reason: String| CheckpointError::File { path: from.state_path.into(), reason };
        let device = self.device().clone();
        let scene = self.ema.load(Scene::load(from.model, &device)?, &from.state).map_err(bad)?;
        let n = scene.gaussians.count();
        let statistics = Statistics::from_tensors(&from.state, n).map_err(bad)?;
        self.statistics.replace(|_| statistics);
        self.optimizer.load(&from.state, &params::sizes(&scene), &device.inner()).map_err(bad)?;
        self.culling.load(&from.state, n);
        self.pending = PendingDensification::load(&from.state);
        self.scene = InPlace::new(scene);
        (self.step, self.initial) = (from.step, from.first_primitives);
        // the run may have been saved before it had a joint stage
        if self.begins_joint() {
            self.update_ema();
        }
        Ok(())
    }

    fn first_primitives(&self) -> usize {
        self.initial
    }
}
