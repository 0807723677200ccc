//! The viewer alongside training in this process.

use super::hub::Hub;
use super::listen::{ViewError, ViewerListener};
use super::live::{Live, Onlooker};
use super::workspace::Workspace;
use crate::run::RunError;
use crate::train::TrainError;
use crate::train::observer::Observer;
use crate::train::run::RunOutcome;
use burn::tensor::Device;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Ends the viewer when the training ends, even by a panic.
struct End<'a> {
    live: &'a Live,
    stop: &'a AtomicBool,
}

impl Drop for End<'_> {
    fn drop(&mut self) {
        self.live.end("The training failed.");
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// Serves the viewer while `train` trains on this thread, with an observer that it passes to
/// [`crate::train::run::run`]. Pictures are drawn on `device`: one that the training does not use, if there is such a
/// device. `ready` is called when the first scene is available. The viewer ends with the training.
/// Returns how the training ended, which does not depend on the viewer, and whether the viewer failed.
pub fn beside(
    listening: ViewerListener,
    device: &Device,
    ready: impl FnOnce(),
    train: impl FnOnce(&mut dyn Observer) -> Result<RunOutcome, TrainError>,
) -> (Result<RunOutcome, TrainError>, Result<(), ViewError>) {
    let hub = Arc::new(Hub::default());
    let live = Arc::new(Live::new(hub.clone()));
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let serve = || {
            let Some(begun) = live.begun() else { return Ok(()) };
            let run = begun.open(device).map_err(RunError::failure)?;
            let space = Workspace::in_training(run, live.clone(), listening.options().read_only);
            listening.serve(space, Vec::new(), hub, &stop, || ())
        };
        let server = std::thread::Builder::new().name("viewer".into()).spawn_scoped(scope, serve);
        let outcome = {
            let _end = End { live: &live, stop: &stop };
            let outcome = train(&mut Onlooker::new(&live, ready));
            live.end(farewell(&outcome));
            outcome
        };
        let served = match server.map(std::thread::ScopedJoinHandle::join) {
            Ok(Ok(served)) => served,
            Ok(Err(_)) => Err(ViewError::System(std::io::Error::other("an internal error stopped it"))),
            Err(error) => Err(ViewError::System(error)),
        };
        (outcome, served)
    })
}

/// The message to windows at the end.
fn farewell(outcome: &Result<RunOutcome, TrainError>) -> String {
    match outcome {
        Ok(RunOutcome { record, .. }) => {
            let how = if record.status == "complete" { "is complete" } else { "was interrupted" };
            format!("The training {how} after {} steps, and this viewer ended with it.", record.steps)
        }
        Err(error) => format!("The training failed: {error}"),
    }
}
