//! Check of the loss: a non-finite value stops the training before anything is learnt from it.

use super::{StepReport, StepTimes, TrainError};
use burn::tensor::{Device, Tensor};

/// Steps between two readings of the loss on a device that runs ahead of the host.
const READ_EVERY: usize = 20;

/// Reads the loss back to the host: at every step, or, on a device that runs ahead of the host and would have to wait,
/// only in the first steps, at every 20th, and before a checkpoint.
#[derive(Clone, Debug)]
pub struct LossWatch {
    runs_ahead: bool,
    /// Steps between checkpoints.
    checkpoint_every: usize,
    /// Steps of the whole training.
    total: usize,
    /// Loss and PSNR when last read.
    last: (f64, f64),
}

impl LossWatch {
    /// Returns a watch over a training of `total` steps on `device` with a checkpoint every `checkpoint_every` steps.
    pub fn new(device: &Device, checkpoint_every: usize, total: usize) -> Self {
        let runs_ahead = crate::device::runs_ahead(device);
        Self { runs_ahead, checkpoint_every, total, last: (f64::NAN, f64::NAN) }
    }

    fn is_due(&self, step: usize) -> bool {
        let done = step + 1;
        let every = |n: usize| n > 0 && done.is_multiple_of(n);
        !self.runs_ahead
            || self.last.0.is_nan()
            || done <= READ_EVERY
            || every(READ_EVERY)
            || every(self.checkpoint_every)
            || done == self.total
    }

    /// Reads the `loss` `[1]` of `step` (from 0), before its gradients are computed, and the mean squared error of the
    /// colours `[1]` that `squared` returns; does nothing at a step at which it is not read.
    ///
    /// # Errors
    /// [`TrainError::NotFinite`] if the loss is not finite.
    pub fn check(
        &mut self,
        step: usize,
        loss: &Tensor<1>,
        squared: impl FnOnce() -> Tensor<1>,
    ) -> Result<(), TrainError> {
        if !self.is_due(step) {
            return Ok(());
        }
        let value = f64::from(loss.clone().into_scalar::<f32>());
        if !value.is_finite() {
            return Err(TrainError::NotFinite { step, what: format!("the loss ({value})") });
        }
        let psnr = -10.0 * f64::from(squared().into_scalar::<f32>()).max(1e-12).log10();
        self.last = (value, psnr);
        Ok(())
    }

    /// Returns the loss, and the PSNR in decibels, of the last step that was read.
    pub fn last(&self) -> (f64, f64) {
        self.last
    }

    /// Returns the report of a step of a training with one stage and without Gaussians.
    pub fn report(&self, step: usize, times: StepTimes) -> StepReport {
        let (loss, psnr) = self.last;
        StepReport { step, stage: "train", loss, psnr, primitives: 0, times }
    }
}
