//! Progress of a job: written by its own thread, read by the drawing thread.

use super::super::hub::Hub;
use schemars::JsonSchema;
use serde::Serialize;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Maximum number of losses that are kept, evenly spaced.
const MAX_LOSSES: usize = 200;
/// Minimum time between wake-ups of the drawing thread.
const PAUSE: Duration = Duration::from_millis(250);

/// The state of a job, as sent to clients.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct JobState {
    /// Its number, by which it is cancelled.
    pub number: u64,
    /// What it does, in words.
    pub title: String,
    /// What is counted, such as `pictures`.
    pub unit: &'static str,
    /// How many of them are done.
    pub done: usize,
    /// How many there are; 0 if that is not known.
    pub all: usize,
    /// Seconds since it began.
    pub seconds: f64,
    /// Seconds until all of the unit are done, at the pace so far.
    pub left: Option<f64>,
    /// Step and smoothed loss of a training, evenly spaced.
    pub losses: Vec<[f64; 2]>,
    /// Whether it was asked to stop.
    pub stopping: bool,
    /// How it ended, if it has.
    pub end: Option<JobEnd>,
    /// Seconds since then.
    pub ago: Option<f64>,
}

/// How a job ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum JobEnd {
    /// Everything is done; says what was made, and where it is.
    Done(String),
    /// It was stopped; everything is as before.
    Stopped,
    /// It failed; says why.
    Failed(String),
}

/// The state of a job, shared by two threads.
#[derive(Debug)]
pub struct JobBoard {
    state: Mutex<JobState>,
    began: Instant,
    stop: AtomicBool,
    /// Grows with every change.
    version: AtomicU64,
}

impl JobBoard {
    /// Makes the board of a job that begins now.
    pub fn new(number: u64, title: String) -> Self {
        Self {
            state: Mutex::new(JobState { number, title, ..JobState::default() }),
            began: Instant::now(),
            stop: AtomicBool::new(false),
            version: AtomicU64::new(1),
        }
    }

    /// Returns the current state.
    pub fn state(&self) -> JobState {
        let mut state = self.lock().clone();
        let now = self.began.elapsed().as_secs_f64();
        match state.end {
            None => state.seconds = now,
            Some(_) => state.ago = Some((now - state.seconds).max(0.0)),
        }
        state
    }

    /// Returns a number that grows with every change.
    pub fn version(&self) -> u64 {
        self.version.load(Ordering::Acquire)
    }

    /// Asks the job to stop.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Release);
        self.change(|state| state.stopping = true);
    }

    /// Records that the job is over.
    pub fn end(&self, end: JobEnd) {
        let seconds = self.began.elapsed().as_secs_f64();
        self.change(|state| (state.end, state.left, state.seconds) = (Some(end), None, seconds));
    }

    fn change(&self, change: impl FnOnce(&mut JobState)) {
        change(&mut self.lock());
        self.version.fetch_add(1, Ordering::AcqRel);
    }

    fn lock(&self) -> MutexGuard<'_, JobState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What a job reports its progress to, and asks whether to go on.
#[derive(Debug)]
pub struct Reporter {
    board: Arc<JobBoard>,
    hub: Arc<Hub>,
    /// When the first of the current unit was begun.
    since: Instant,
    woke: Instant,
    /// One of this many losses is kept.
    every: usize,
}

impl Reporter {
    /// Makes a reporter that writes to `board` and wakes the drawing thread.
    pub fn new(board: Arc<JobBoard>, hub: Arc<Hub>) -> Self {
        Self { board, hub, since: Instant::now(), woke: Instant::now(), every: 1 }
    }

    /// Whether the job has not been asked to stop.
    pub fn goes_on(&self) -> bool {
        !self.board.stop.load(Ordering::Acquire)
    }

    /// Reports that `done` of `all` of a `unit` are done, with this loss; returns whether to go on.
    pub fn report(&mut self, unit: &'static str, done: usize, all: usize, loss: Option<f64>) -> bool {
        self.board.change(|state| {
            if state.unit != unit {
                self.since = Instant::now();
            }
            let pace = self.since.elapsed().as_secs_f64() / done.max(1) as f64;
            state.left = (done > 0).then(|| pace * all.saturating_sub(done) as f64);
            (state.unit, state.done, state.all) = (unit, done, all);
            let Some(loss) = loss.filter(|_| done.is_multiple_of(self.every)) else { return };
            state.losses.push([done as f64, loss]);
            if state.losses.len() >= MAX_LOSSES {
                self.every *= 2;
                let every = self.every;
                state.losses.retain(|[step, _]| (*step as usize).is_multiple_of(every));
            }
        });
        if self.woke.elapsed() > PAUSE {
            self.woke = Instant::now();
            self.hub.wake();
        }
        self.goes_on()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_training_keeps_few_losses_and_estimates_the_time_left() {
        let board = Arc::new(JobBoard::new(1, "training".into()));
        let mut reporter = Reporter::new(board.clone(), Arc::new(Hub::default()));
        assert!(reporter.report("views", 3, 3, None));
        for step in 1..=10_000 {
            assert!(reporter.report("steps", step, 20_000, Some(1.0 / step as f64)));
        }
        let state = board.state();
        assert_eq!((state.unit, state.done, state.all, state.end), ("steps", 10_000, 20_000, None));
        assert!((MAX_LOSSES / 2 - 1..MAX_LOSSES).contains(&state.losses.len()), "{}", state.losses.len());
        assert!(state.losses.windows(2).all(|w| w[1][0] - w[0][0] == state.losses[0][0]), "evenly spaced");
        let left = state.left.unwrap();
        assert!(left > 0.0 && left <= state.seconds * 1.1, "half of it is done: {left} of {}", state.seconds);
        let version = board.version();
        board.stop();
        assert!(!reporter.report("steps", 10_001, 20_000, None) && board.state().stopping);
        board.end(JobEnd::Stopped);
        assert!(board.version() > version && board.state().end == Some(JobEnd::Stopped));
        let seconds = board.state().seconds;
        std::thread::sleep(Duration::from_millis(5));
        let later = board.state();
        assert!(later.seconds == seconds && later.ago >= Some(0.005), "{later:?}");
    }
}
