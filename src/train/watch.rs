//! The guard over the loss: what is not finite stops a training before anything is learnt from it.

use super::TrainError;
use burn::tensor::{Device, Tensor};

/// Steps between two looks at the loss on a device that runs ahead of the host.
const LOOK_EVERY: usize = 20;

/// Brings the loss to the host: at every step, but on a device that runs ahead of the host, which would have to wait, only in
/// the first steps, at every 20th, and before a checkpoint.
#[derive(Clone, Debug)]
pub struct LossWatch {
    runs_ahead: bool,
    /// Steps between checkpoints.
    checkpoint_every: usize,
    /// Steps of the whole training.
    total: usize,
    /// Loss and PSNR when they were last looked at.
    last: (f64, f64),
}

impl LossWatch {
    /// One for a training of `total` steps on `device` with a checkpoint every `checkpoint_every` steps.
    #[must_use]
    pub fn new(device: &Device, checkpoint_every: usize, total: usize) -> Self {
        let runs_ahead = crate::device::runs_ahead(device);
        Self { runs_ahead, checkpoint_every, total, last: (f64::NAN, f64::NAN) }
    }

    fn looks(&self, step: usize) -> bool {
        let done = step + 1;
        let every = |n: usize| n > 0 && done.is_multiple_of(n);
        !self.runs_ahead
            || self.last.0.is_nan()
            || done <= LOOK_EVERY
            || every(LOOK_EVERY)
            || every(self.checkpoint_every)
            || done == self.total
    }

    /// Looks at the `loss` `[1]` of `step` (from 0), before its gradients are taken, and at the mean squared error of the colours
    /// that `squared` gives, `[1]`; or leaves the device alone.
    ///
    /// # Errors
    /// [`TrainError::NotFinite`] if the loss is not finite.
    pub fn look(
        &mut self,
        step: usize,
        loss: &Tensor<1>,
        squared: impl FnOnce() -> Tensor<1>,
    ) -> Result<(), TrainError> {
        if !self.looks(step) {
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

    /// Loss, and PSNR in decibels, of the last step that was looked at.
    #[must_use]
    pub fn last(&self) -> (f64, f64) {
        self.last
    }
}
