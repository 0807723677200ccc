//! Pauses of a run at the wish of its observer.

use super::clock::RunClock;
use super::progress::ProgressReporter;
use crate::train::observer::{Observer, RunProgress, TrainingAction};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Interval at which an observer is asked whether a pause is over.
const POLL: Duration = Duration::from_millis(20);

/// Shows the run to its observer, and waits while that pauses it.
pub(super) struct Pauses<'a> {
    pub(super) observer: Option<&'a mut dyn Observer>,
    /// Ends a pause.
    pub(super) stop: &'a AtomicBool,
}

impl Pauses<'_> {
    /// Calls the observer before a step and waits for as long as it pauses the training, at most until a stop is
    /// requested. `clock` excludes the pause; there is none after the last step.
    pub(super) fn wait(&mut self, now: &RunProgress<'_>, clock: &mut RunClock, progress: &ProgressReporter) {
        let Some(observer) = &mut self.observer else { return };
        if observer.on_step(now) == TrainingAction::Continue || now.steps >= now.until {
            return;
        }
        progress.pause_begins(now.steps);
        let began = Instant::now();
        while !self.stop.load(Ordering::Relaxed) && observer.on_step(now) == TrainingAction::Pause {
            std::thread::sleep(POLL);
        }
        clock.exclude(began.elapsed());
        progress.pause_ends();
    }
}
