//! Extension points: loss terms, space-time encoders, learning-rate schedules and metrics of your own, without a
//! change of this crate.
//!
//! A small program registers them by name, then hands over to [`crate::main`]; configurations, sweeps and commands
//! know them by these names from then on. `docs/research.md` shows one of each, `examples/extended` is such a program.
//!
//! A name is made of letters, digits, `-` and `_`; any other character becomes `_`. Registering a name again
//! replaces what had it. The registry is one for the whole process: register before training or loading a scene.

mod encoder;
mod loss;
mod metric;
mod registry;
mod schedule;

pub use encoder::{EncoderDefinition, Parameter, Parameters};
pub use loss::{LossInput, LossTerm};
pub use metric::{Metric, MetricInput};
pub(crate) use metric::{means, measure};
pub use registry::NotRegistered;
pub use schedule::Schedule;

use registry::Registry;
use std::sync::Arc;

static LOSS_TERMS: Registry<dyn LossTerm> = Registry::new("loss term");
static ENCODERS: Registry<dyn EncoderDefinition> = Registry::new("encoder");
static SCHEDULES: Registry<dyn Schedule> = Registry::new("schedule");
static METRICS: Registry<dyn Metric> = Registry::new("metric");

/// Registers a loss term; `loss.extra.NAME = WEIGHT` uses it.
pub fn loss_term(name: &str, term: impl LossTerm + 'static) {
    LOSS_TERMS.insert(name, Arc::new(term));
}

/// Registers an encoder; `model.encoder = "extra"` with `model.extra_encoder = "NAME"` uses it.
pub fn encoder(name: &str, definition: impl EncoderDefinition + 'static) {
    ENCODERS.insert(name, Arc::new(definition));
}

/// Registers a schedule; `optim.schedule = "NAME"` uses it. A built-in one of that name is replaced.
pub fn schedule(name: &str, schedule: impl Schedule + 'static) {
    SCHEDULES.insert(name, Arc::new(schedule));
}

/// Registers a metric; every evaluation takes it from then on. Its name should not be that of a built-in metric.
pub fn metric(name: &str, metric: impl Metric + 'static) {
    METRICS.insert(name, Arc::new(metric));
}

/// The loss term of that name.
///
/// # Errors
/// [`NotRegistered`], which lists those that are.
pub fn find_loss_term(name: &str) -> Result<Arc<dyn LossTerm>, NotRegistered> {
    LOSS_TERMS.get(name)
}

/// The encoder of that name.
///
/// # Errors
/// [`NotRegistered`], which lists those that are.
pub fn find_encoder(name: &str) -> Result<Arc<dyn EncoderDefinition>, NotRegistered> {
    ENCODERS.get(name)
}

/// The schedule of that name, if it is not one of the built-in ones.
///
/// # Errors
/// [`NotRegistered`], which lists those that are.
pub fn find_schedule(name: &str) -> Result<Arc<dyn Schedule>, NotRegistered> {
    SCHEDULES.get(name)
}

/// All registered metrics by name, in the order of the names.
#[must_use]
pub fn metrics() -> Vec<(String, Arc<dyn Metric>)> {
    METRICS.all()
}
