//! The scene that a client clicks on, prepared beside the drawing thread while nobody clicks, so that a click is
//! answered at once.

use super::reading::OpenedRun;
use super::workspace::Workspace;
use crate::run::RunError;
use crate::run::pick::Clicking;
use std::thread::JoinHandle;

/// A scene to click on, at a revision of the document and a time.
#[derive(Debug)]
pub struct Clicks {
    revision: u64,
    time: f64,
    state: ClickState,
}

#[derive(Debug)]
enum ClickState {
    Ready(Box<Clicking>),
    /// A thread is preparing it.
    Soon(JoinHandle<Clicking>),
}

impl Clicks {
    fn fits(&self, space: &Workspace, time: f64) -> bool {
        self.revision == space.revision() && self.time == time
    }

    /// Returns the scene, if it is ready.
    fn into_ready(self) -> Option<Clicking> {
        match self.state {
            ClickState::Ready(clicking) => Some(*clicking),
            ClickState::Soon(thread) if thread.is_finished() => thread.join().ok(),
            ClickState::Soon(_) => None,
        }
    }

    fn begin(space: &Workspace, time: f64) -> Clicking {
        Clicking::new(&space.shown.run, space.shown.segments.now(), space.shown.field.as_ref(), time)
    }

    /// Begins to prepare the scene at `time`, unless that was done, or an earlier one is still being prepared.
    pub fn prepare(now: &mut Option<Self>, space: &Workspace, time: f64) {
        let busy = |c: &Self| matches!(&c.state, ClickState::Soon(thread) if !thread.is_finished());
        if space.shown.field.is_none() || now.as_ref().is_some_and(|c| c.fits(space, time) || busy(c)) {
            return;
        }
        let OpenedRun { run, segments, field, .. } = &space.shown;
        let (run, segments, field) = (run.share(), segments.now().clone(), field.clone());
        // what the field says about the Gaussians is the same at all times
        let before = now.take().filter(|c| c.revision == space.revision()).and_then(Self::into_ready);
        let thread = std::thread::Builder::new().name("clicks".into()).spawn(move || {
            let clicking = Clicking::new(&run, &segments, field.as_ref(), time);
            let clicking = match before {
                Some(before) => clicking.recalling(before),
                None => clicking,
            };
            clicking.prepare();
            clicking
        });
        // without a thread, the click does it
        *now = thread.ok().map(|thread| Self { revision: space.revision(), time, state: ClickState::Soon(thread) });
    }

    /// Returns the scene at `time`, after waiting for it or preparing it.
    ///
    /// # Errors
    /// If the preparation failed.
    pub fn get<'c>(now: &'c mut Option<Self>, space: &Workspace, time: f64) -> Result<&'c Clicking, RunError> {
        let failed = || RunError::failure("the scene cannot be prepared for clicks");
        let clicking = match now.take().filter(|c| c.fits(space, time)).map(|c| c.state) {
            Some(ClickState::Ready(clicking)) => clicking,
            Some(ClickState::Soon(thread)) => Box::new(thread.join().map_err(|_| failed())?),
            None => Box::new(Self::begin(space, time)),
        };
        let ready = now.insert(Self { revision: space.revision(), time, state: ClickState::Ready(clicking) });
        match &ready.state {
            ClickState::Ready(clicking) => Ok(clicking),
            ClickState::Soon(_) => Err(failed()),
        }
    }

    /// Returns the scene that was clicked on last.
    pub fn last(&self) -> Option<&Clicking> {
        match &self.state {
            ClickState::Ready(clicking) => Some(clicking),
            ClickState::Soon(_) => None,
        }
    }
}
