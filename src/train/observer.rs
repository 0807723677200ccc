//! Who looks on while a run trains, and may have it pause between two steps.
//!
//! Whatever an observer does, no step depends on it: it sees the model and cannot change it, and the training draws no
//! random numbers of its account.

use super::StepReport;
use super::run::RunRecord;
use crate::config::types::Config;
use crate::model::Model;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How often an observer is asked whether a pause is over.
const ASK: Duration = Duration::from_millis(20);

/// How far a training has come.
#[derive(Clone, Copy, Debug)]
pub struct Moment<'a> {
    /// Folder of the run.
    pub run: &'a Path,
    /// Its configuration.
    pub config: &'a Config,
    /// Its record, as it was written last.
    pub record: &'a RunRecord,
    /// What is trained, on the device that it trains on.
    pub model: &'a dyn Model,
    /// Steps taken, those before a resume with them.
    pub steps: usize,
    /// Steps at which this training ends.
    pub until: usize,
    /// Seconds of training, without pauses.
    pub seconds: f64,
    /// The last step; none before the first.
    pub report: Option<StepReport>,
}

/// What a training does next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// The next step.
    GoOn,
    /// Nothing; the observer is asked again.
    Pause,
}

/// Looks on while a run trains.
pub trait Observer {
    /// Called before the first step, after every one, and again and again during a pause; the training waits for it. After
    /// the last step there is no pause.
    fn look(&mut self, now: &Moment<'_>) -> Next;
}

/// Nobody looks on.
#[derive(Clone, Copy, Debug, Default)]
pub struct Nobody;

impl Observer for Nobody {
    fn look(&mut self, _: &Moment<'_>) -> Next {
        Next::GoOn
    }
}

/// Lets `observer` look, and waits for as long as it has the training pause, at most until `stop` is raised. A pause
/// begins with `begin`. Gives the time for which the training paused.
pub fn wait_for(observer: &mut dyn Observer, now: &Moment<'_>, stop: &AtomicBool, begin: impl FnOnce()) -> Duration {
    if observer.look(now) == Next::GoOn || now.steps >= now.until {
        return Duration::ZERO;
    }
    begin();
    let began = Instant::now();
    while !stop.load(Ordering::Relaxed) && observer.look(now) == Next::Pause {
        std::thread::sleep(ASK);
    }
    began.elapsed()
}
