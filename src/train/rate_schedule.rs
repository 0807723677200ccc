//! Learning-rate schedules.

use crate::registry::{NotRegistered, Registry};
use std::sync::Arc;

pub(crate) static SCHEDULES: Registry<dyn Schedule> = Registry::new("schedule");

/// A course of the learning rates of means, encoder, decoder and embedding, in place of `optim.final_fraction ^ progress`.
///
/// The other groups keep `optim.attributes_final_fraction`.
pub trait Schedule: Send + Sync {
    /// What these rates are multiplied by; finite, 0 or above.
    ///
    /// `progress` in [0, 1] is the step of the joint stage over `stages.joint_steps`. In warm-up, where of these only the
    /// means are trained, it is the step over `optim.warmup_decay_steps`, and may end below 1 or stay at 1.
    fn factor(&self, progress: f64) -> f64;
}

/// The schedule of that name, if it is not one of the built-in ones.
///
/// # Errors
/// [`NotRegistered`], which lists those that are.
pub fn find_schedule(name: &str) -> Result<Arc<dyn Schedule>, NotRegistered> {
    SCHEDULES.get(name)
}
