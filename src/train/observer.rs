//! Observers of a run while it trains, which may pause it between two steps.
//!
//! No step depends on what an observer does: it sees the model but cannot change it, and the training draws no random
//! numbers on its account.

use super::StepReport;
use super::run::RunRecord;
use crate::config::types::Config;
use crate::model::Model;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Interval at which an observer is asked whether a pause is over.
const ASK: Duration = Duration::from_millis(20);

/// Progress of a training.
#[derive(Clone, Copy, Debug)]
pub struct Moment<'a> {
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
pub enum Next {
    /// Takes the next step.
    Continue,
    /// Waits; the observer is asked again.
    Pause,
}

/// Watches a run while it trains.
pub trait Observer {
    /// Called before the first step, after every step, and repeatedly during a pause; the training waits for it. After
    /// the last step there is no pause.
    fn look(&mut self, now: &Moment<'_>) -> Next;
}

/// An observer that does nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoObserver;

impl Observer for NoObserver {
    fn look(&mut self, _: &Moment<'_>) -> Next {
        Next::Continue
    }
}

/// Calls `observer` and waits for as long as it pauses the training, at most until `stop` is raised. Calls `begin` at
/// the start of a pause. Returns the duration of the pause.
pub fn wait_for(observer: &mut dyn Observer, now: &Moment<'_>, stop: &AtomicBool, begin: impl FnOnce()) -> Duration {
    if observer.look(now) == Next::Continue || now.steps >= now.until {
        return Duration::ZERO;
    }
    begin();
    let began = Instant::now();
    while !stop.load(Ordering::Relaxed) && observer.look(now) == Next::Pause {
        std::thread::sleep(ASK);
    }
    began.elapsed()
}
