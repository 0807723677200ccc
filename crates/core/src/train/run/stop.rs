//! When a run ends.

use super::clock::RunClock;
use std::sync::atomic::{AtomicBool, Ordering};

/// Why a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopReason {
    /// All steps are taken.
    AllSteps,
    /// The time of `output.max_minutes` is over.
    TimeLimit,
    /// The steps of [`super::RunOptions::stop_after`] are taken.
    StepLimit,
    /// [`super::RunContext::stop`] was raised.
    Requested,
}

impl StopReason {
    /// Whether the run is at its end; otherwise it was interrupted.
    pub fn is_complete(self) -> bool {
        matches!(self, Self::AllSteps | Self::TimeLimit)
    }

    /// The status in the run's record.
    pub(super) fn status(self) -> &'static str {
        if self.is_complete() { "complete" } else { "interrupted" }
    }
}

/// Decides before every step whether the run ends.
#[derive(Debug)]
pub(super) struct StopRule<'a> {
    total: usize,
    limit: usize,
    requested: &'a AtomicBool,
}

impl<'a> StopRule<'a> {
    /// Returns the rule for a training of `total` steps, to be stopped after `stop_after` of them or when `requested` is
    /// raised.
    pub(super) fn new(total: usize, stop_after: Option<usize>, requested: &'a AtomicBool) -> Self {
        Self { total, limit: stop_after.map_or(total, |steps| steps.min(total)), requested }
    }

    /// Steps of the whole training.
    pub(super) fn total(&self) -> usize {
        self.total
    }

    /// Number of steps at which this run ends at the latest.
    pub(super) fn limit(&self) -> usize {
        self.limit
    }

    /// Returns why the run ends after `steps` steps; `None` if it goes on. A run resumed after its time is over takes no
    /// step; a new one takes one, so that there is a checkpoint.
    pub(super) fn check(&self, steps: usize, clock: &RunClock) -> Option<StopReason> {
        if steps == self.total {
            Some(StopReason::AllSteps)
        } else if steps > 0 && clock.seconds_left() <= 0.0 {
            Some(StopReason::TimeLimit)
        } else if steps >= self.limit {
            Some(StopReason::StepLimit)
        } else if self.requested.load(Ordering::Relaxed) {
            Some(StopReason::Requested)
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_the_run_goes_before_an_interruption() {
        let stop = AtomicBool::new(false);
        let (clock, late) = (RunClock::start(0.0, 0.0), RunClock::start(61.0, 1.0));
        let rule = StopRule::new(10, Some(4), &stop);
        assert_eq!((rule.check(3, &clock), rule.check(4, &clock)), (None, Some(StopReason::StepLimit)));
        assert_eq!(rule.check(3, &late), Some(StopReason::TimeLimit));
        assert_eq!(rule.check(0, &late), None, "a new run takes a step");
        stop.store(true, Ordering::Relaxed);
        assert_eq!(rule.check(3, &clock), Some(StopReason::Requested));
        assert_eq!(rule.check(10, &late), Some(StopReason::AllSteps));
        assert_eq!(StopRule::new(10, Some(40), &stop).limit(), 10);
    }
}
