//! Learning-rate schedules. To add a built-in one, implement [`Schedule`] and add a line to [`SCHEDULES`].

use crate::config::types::OptimConfig;
use crate::registry::{NotRegistered, Registry};
use std::f64::consts::PI;

/// All schedules, which `optim.schedule` chooses from.
pub static SCHEDULES: Registry<dyn Schedule> =
    Registry::new("schedule", &[("log-linear", &LogLinear), ("cosine", &Cosine), ("constant", &Constant)]);

/// A schedule of the learning rates of means, encoder, decoder and embedding.
///
/// The other parameter groups keep `optim.attributes_final_fraction`.
pub trait Schedule: Send + Sync {
    /// Returns the factor applied to these rates; finite, 0 or above.
    ///
    /// `progress` in [0, 1] is the step of the joint stage over `stages.joint_steps`. In warm-up, which trains only the
    /// means among these, it is the step over `optim.warmup_decay_steps`, and may end below 1 or stay at 1.
    fn factor(&self, progress: f64, optim: &OptimConfig) -> f64;

    /// Rejects settings that it cannot follow.
    ///
    /// # Errors
    /// The first such key with its value, and the values allowed.
    fn check(&self, _: &OptimConfig) -> Result<(), String> {
        Ok(())
    }
}

/// Falls by the same factor at every step, to `optim.final_fraction`.
struct LogLinear;

impl Schedule for LogLinear {
    fn factor(&self, progress: f64, optim: &OptimConfig) -> f64 {
        optim.final_fraction.powf(progress)
    }

    fn check(&self, optim: &OptimConfig) -> Result<(), String> {
        // a rate that falls to zero by a factor is zero from the second step on
        let last = optim.final_fraction;
        if last < 1e-9 { Err(format!("optim.final_fraction = {last:?}: above 0 (at least 1.0e-9)")) } else { Ok(()) }
    }
}

/// Half a period of a cosine, down to `optim.final_fraction`.
struct Cosine;

impl Schedule for Cosine {
    fn factor(&self, progress: f64, optim: &OptimConfig) -> f64 {
        let last = optim.final_fraction;
        last + (1.0 - last) * 0.5 * (1.0 + (PI * progress).cos())
    }
}

/// Stays as it is.
struct Constant;

impl Schedule for Constant {
    fn factor(&self, _: f64, _: &OptimConfig) -> f64 {
        1.0
    }
}

/// Returns the schedule of that name.
///
/// # Errors
/// [`NotRegistered`], which lists the registered names.
pub fn find_schedule(name: &str) -> Result<&'static dyn Schedule, NotRegistered> {
    SCHEDULES.get(name)
}

/// Rejects a schedule that does not exist, that rejects the settings, or whose factors are no rates.
///
/// # Errors
/// The first such key with its value, and the values allowed.
pub fn check(optim: &OptimConfig) -> Result<(), String> {
    let name = &optim.schedule;
    let schedule = find_schedule(name).map_err(|e| format!("optim.schedule: {e}"))?;
    schedule.check(optim)?;
    let factors = (0..=100).map(|k| schedule.factor(f64::from(k) / 100.0, optim));
    match factors.into_iter().find(|f| !(f.is_finite() && *f >= 0.0)) {
        Some(factor) => Err(format!("optim.schedule = \"{name}\" gives a factor of {factor}: finite, 0 or above")),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::types::Config;

    #[test]
    fn the_built_in_schedules_end_where_they_say() {
        let optim = OptimConfig { final_fraction: 0.01, ..Config::default().optim };
        let course = |name: &str| [0.0, 0.5, 1.0].map(|p| find_schedule(name).unwrap().factor(p, &optim));
        assert_eq!(course("log-linear"), [1.0, 0.01f64.powf(0.5), 0.01]);
        assert_eq!(course("constant"), [1.0; 3]);
        let [start, middle, end] = course("cosine");
        assert!((start - 1.0).abs() < 1e-12 && (middle - 0.505).abs() < 1e-12 && (end - 0.01).abs() < 1e-12);
    }
}
