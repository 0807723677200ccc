//! The time that a run has trained.

use std::time::{Duration, Instant};

/// Measures the seconds of training over all processes of a run, without pauses.
#[derive(Clone, Copy, Debug)]
pub(super) struct RunClock {
    /// Seconds of training in earlier processes.
    before: f64,
    started: Instant,
    paused: Duration,
    /// Most seconds of training; infinite without a limit.
    limit: f64,
}

impl RunClock {
    /// Starts after `before` seconds of training in earlier processes; `max_minutes` limits them all, 0 for no limit.
    pub(super) fn start(before: f64, max_minutes: f64) -> Self {
        let limit = if max_minutes > 0.0 { 60.0 * max_minutes } else { f64::INFINITY };
        Self { before, started: Instant::now(), paused: Duration::ZERO, limit }
    }

    /// Seconds of training so far.
    pub(super) fn seconds(&self) -> f64 {
        self.before + (self.started.elapsed() - self.paused).as_secs_f64()
    }

    /// Seconds of training in this process.
    pub(super) fn seconds_here(&self) -> f64 {
        self.seconds() - self.before
    }

    /// Seconds until the limit; infinite without one.
    pub(super) fn seconds_left(&self) -> f64 {
        self.limit - self.seconds()
    }

    /// Leaves out a pause that has just ended.
    pub(super) fn exclude(&mut self, pause: Duration) {
        self.paused += pause;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn earlier_processes_count_and_pauses_do_not() {
        let mut clock = RunClock::start(50.0, 1.0);
        std::thread::sleep(Duration::from_millis(20));
        assert!(clock.seconds_here() >= 0.02 && clock.seconds() >= 50.02 && clock.seconds_left() <= 9.98);
        clock.exclude(clock.started.elapsed());
        assert!(clock.seconds_here() < 0.02);
        assert_eq!(RunClock::start(50.0, 0.0).seconds_left(), f64::INFINITY);
    }
}
