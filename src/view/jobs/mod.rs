//! Long work that a client starts: one job at a time, on a thread of its own beside the drawing thread. It holds the
//! run as a command would, so that commands are refused meanwhile, and goes on when the client that started it leaves.

pub mod board;
pub mod export;
pub mod task;

use super::background::guarded;
use super::hub::Hub;
use crate::files::{LOCK_PATIENCE, LockDuration};
use crate::run::{OpenRun, RunError};
use board::{JobBoard, JobEnd, JobState, Reporter};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use task::Task;

/// Minimum time between messages to clients about a job.
const PAUSE: Duration = Duration::from_millis(200);

/// The current job, or the last one.
#[derive(Debug)]
pub struct Jobs {
    hub: Arc<Hub>,
    board: Option<Arc<JobBoard>>,
    thread: Option<JoinHandle<()>>,
    number: u64,
    /// Version of the state that was sent last, and when.
    sent: (u64, Instant),
}

impl Jobs {
    /// Starts without a job; `hub` wakes the drawing thread.
    pub fn new(hub: Arc<Hub>) -> Self {
        Self { hub, board: None, thread: None, number: 0, sent: (0, Instant::now()) }
    }

    /// Starts a job on `run`, which holds no lock.
    ///
    /// # Errors
    /// If one is under way, the task is invalid, or the system gives no thread.
    pub fn start(&mut self, run: OpenRun, task: Task) -> Result<(), String> {
        task.check()?;
        if let Some(JobState { title, end: None, .. }) = self.state() {
            return Err(format!("{title}: is under way; wait until it ends, or cancel it"));
        }
        self.join();
        let number = self.number + 1;
        let board = Arc::new(JobBoard::new(number, task.to_string()));
        let mut report = Reporter::new(board.clone(), self.hub.clone());
        let (shared, hub) = (board.clone(), self.hub.clone());
        let work = move || {
            shared.end(match guarded(|| carry_out(&task, &run, &mut report)) {
                Ok(Some(made)) => JobEnd::Done(made),
                Ok(None) => JobEnd::Stopped,
                Err(error) => JobEnd::Failed(error.to_string()),
            });
            hub.wake();
        };
        let thread = std::thread::Builder::new().name("job".into()).spawn(work);
        self.thread = Some(thread.map_err(|e| format!("cannot start a thread for this: {e}"))?);
        (self.number, self.board, self.sent.0) = (number, Some(board), 0);
        Ok(())
    }

    /// Asks job `number` to stop.
    ///
    /// # Errors
    /// If it is not under way.
    pub fn cancel(&self, number: u64) -> Result<(), String> {
        match (&self.board, self.state()) {
            (Some(board), Some(JobState { number: now, end: None, .. })) if now == number => {
                board.stop();
                Ok(())
            }
            _ => Err("this job has already ended".into()),
        }
    }

    /// Returns the state of the current job, or how the last one ended.
    pub fn state(&self) -> Option<JobState> {
        self.board.as_ref().map(|board| board.state())
    }

    /// Returns the state if it is to be sent to clients now: it changed, and was not sent just before.
    pub fn changed(&mut self) -> Option<JobState> {
        let board = self.board.as_ref()?;
        let (version, (sent, when)) = (board.version(), self.sent);
        if version == sent {
            return None;
        }
        let state = board.state();
        if sent != 0 && state.end.is_none() && when.elapsed() < PAUSE {
            return None;
        }
        self.sent = (version, Instant::now());
        Some(state)
    }

    fn join(&mut self) {
        if let Some(thread) = self.thread.take() {
            // it catches its own panics
            let _ = thread.join();
        }
    }
}

/// Stops the job and waits for its end, so that a viewer that closes leaves nothing half written.
impl Drop for Jobs {
    fn drop(&mut self) {
        if let Some(board) = &self.board {
            board.stop();
        }
        self.join();
    }
}

fn carry_out(task: &Task, run: &OpenRun, report: &mut Reporter) -> Result<Option<String>, RunError> {
    let _lock = run.lock(&format!("volseggs view: {task}"), LockDuration::Long, LOCK_PATIENCE)?;
    task.carry_out(run, report)
}
