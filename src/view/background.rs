//! Changes of segments that take so long to compute that pictures would stop meanwhile: they are computed on a thread
//! of their own, on a copy of the segments, and adopted by the drawing thread unless the document was changed
//! meanwhile.

use super::hub::{ClientId, Hub};
use crate::run::segments::RunSegments;
use crate::run::{OpenRun, RunError};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError, channel};

/// Maximum number of changes that are computed at once; further ones are refused.
const MAX_AT_ONCE: usize = 4;

/// Who requested a change, and of what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChangeRequest {
    /// The client.
    pub client: ClientId,
    /// Number by which the answer is identified.
    pub id: u32,
    /// Revision of the document that the client knows.
    pub base: u64,
    /// Number of the client's selection that becomes a segment, if one does.
    pub selection: Option<u64>,
}

/// The segments after a change, not saved yet, or why there is none.
type ChangeResult = Result<RunSegments, RunError>;

/// The changes that are being computed.
#[derive(Debug)]
pub struct BackgroundChanges {
    hub: Arc<Hub>,
    running: Vec<(ChangeRequest, Receiver<ChangeResult>)>,
}

impl BackgroundChanges {
    /// Starts without any; `hub` wakes the drawing thread.
    pub fn new(hub: Arc<Hub>) -> Self {
        Self { hub, running: Vec::new() }
    }

    /// Begins to change `segments` of `run`.
    ///
    /// # Errors
    /// If too many are under way, or the system gives no thread.
    pub fn begin(
        &mut self,
        request: ChangeRequest,
        run: OpenRun,
        mut segments: RunSegments,
        change: impl FnOnce(&OpenRun, &mut RunSegments) -> Result<(), RunError> + Send + 'static,
    ) -> Result<(), RunError> {
        if self.running.len() >= MAX_AT_ONCE {
            return Err(RunError::input("other changes of the segments are under way; try again in a moment"));
        }
        let (hub, (out, found)) = (self.hub.clone(), channel());
        let work = move || {
            let done = guarded(|| change(&run, &mut segments)).map(|()| segments);
            // nobody waits any more if the viewer has ended
            let _ = out.send(done);
            hub.wake();
        };
        std::thread::Builder::new().name("segments".into()).spawn(work).map_err(RunError::failure)?;
        self.running.push((request, found));
        Ok(())
    }

    /// Returns a finished change; of several, the one that was requested first.
    pub fn finished(&mut self) -> Option<(ChangeRequest, ChangeResult)> {
        for (index, (request, found)) in self.running.iter().enumerate() {
            let result = match found.try_recv() {
                Ok(found) => (*request, found),
                Err(TryRecvError::Empty) => continue,
                Err(TryRecvError::Disconnected) => (*request, Err(failed())),
            };
            self.running.remove(index);
            return Some(result);
        }
        None
    }

    /// Waits for the change that was requested first of those under way.
    pub fn wait(&mut self) -> Option<(ChangeRequest, ChangeResult)> {
        if self.running.is_empty() {
            return None;
        }
        let (request, found) = self.running.remove(0);
        Some((request, found.recv().unwrap_or_else(|_| Err(failed()))))
    }
}

/// Message about a panic.
pub(super) const INTERNAL_ERROR: &str = "an internal error stopped this; the viewer continues";

fn failed() -> RunError {
    RunError::failure(INTERNAL_ERROR)
}

/// Does work of one client: the viewer goes on, whatever goes wrong in it.
pub(super) fn guarded<T>(work: impl FnOnce() -> Result<T, RunError>) -> Result<T, RunError> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| Err(failed()))
}
