//! Learning-rate schedules.

use crate::registry::{NotRegistered, Registry};
use std::sync::Arc;

/// Schedules by name.
pub static SCHEDULES: Registry<dyn Schedule> = Registry::new("schedule");

/// A schedule of the learning rates of means, encoder, decoder and embedding, replacing `optim.final_fraction ^
/// progress`.
///
/// The other parameter groups keep `optim.attributes_final_fraction`.
pub trait Schedule: Send + Sync {
    /// Returns the factor applied to these rates; finite, 0 or above.
    ///
    /// `progress` in [0, 1] is the step of the joint stage over `stages.joint_steps`. In warm-up, which trains only the
    /// means among these, it is the step over `optim.warmup_decay_steps`, and may end below 1 or stay at 1.
    fn factor(&self, progress: f64) -> f64;
}

/// Returns the registered schedule of that name; the built-in schedules are not registered.
///
/// # Errors
/// [`NotRegistered`], which lists the registered names.
pub fn find_schedule(name: &str) -> Result<Arc<dyn Schedule>, NotRegistered> {
    SCHEDULES.get(name)
}
