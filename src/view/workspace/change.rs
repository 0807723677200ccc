//! Changes of segments and edits: each takes the lock, reads what others wrote, and is refused to a client that does
//! not know that.

use super::Workspace;
use crate::edit::Edit;
use crate::files::{LockDuration, RunLock};
use crate::run::segments::{HistoryDirection, RunSegments};
use crate::run::{OpenRun, RunError, edits};
use crate::segment::segmentation::renamed;
use crate::view::order::{HistoryStack, StepCounts};
use crate::view::protocol::Change;
use crate::view::reading::stamps;
use crate::view::refusal::ChangeError;
use std::time::Duration;

/// The command that is named to others while this process holds the run.
const COMMAND: &str = "volseggs view";
/// Longest wait for the short work of a command: the drawing thread waits meanwhile.
const PATIENCE: Duration = Duration::from_millis(200);

impl Workspace {
    /// Carries out a change of a client that knows revision `base`.
    ///
    /// # Errors
    /// If the document has another revision by now, or the change cannot be made; everything is then as before.
    pub fn change(&mut self, base: u64, change: &Change) -> Result<(), ChangeError> {
        let lock = self.begin(base, PATIENCE)?;
        let towards = |undo: bool| if undo { HistoryDirection::Undo } else { HistoryDirection::Redo };
        let steps = self.steps();
        let mut segments = self.shown.segments.clone();
        let last;
        let change = match change {
            Change::Last { undo } => {
                last = self.last(*undo)?;
                &last
            }
            other => other,
        };
        match change {
            Change::Edit { segments, operation } => {
                let edit = Edit { segments: segments.clone(), operation: operation.clone() };
                self.shown.edits = edits::push(&self.shown.run, edit)?.0;
                return self.end(lock, steps, None);
            }
            Change::Edits { undo } => {
                self.shown.edits = edits::step(&self.shown.run, towards(*undo), 1)?;
                return self.end(lock, steps, None);
            }
            Change::Coarse { time, clusters } => coarse(&self.shown.run, &mut segments, *time, *clusters)?,
            Change::Group { name, segments: of } => segments.group(name, of)?,
            Change::Rename { segment, name } => segments.rename(&self.shown.run, segment, name)?,
            Change::Remove { segments: of } => drop(segments.remove(of)?),
            Change::Segments { undo } => drop(segments.step(towards(*undo), 1)?),
            Change::Last { .. } => {}
        }
        self.end(lock, steps, Some(segments))
    }

    /// Returns run and segments, to be changed on another thread, for a client that knows revision `base`.
    ///
    /// # Errors
    /// If nothing may be changed, or the document has another revision by now.
    pub fn copy(&mut self, base: u64) -> Result<(OpenRun, RunSegments), ChangeError> {
        Ok((self.for_work(base)?, self.shown.segments.clone()))
    }

    /// Replaces the segments by a changed [`Self::copy`] of revision `base`.
    ///
    /// # Errors
    /// As [`Workspace::change`].
    pub fn adopt(&mut self, base: u64, segments: RunSegments) -> Result<(), ChangeError> {
        // a longer wait, as seconds of work would be lost
        let lock = self.begin(base, 10 * PATIENCE)?;
        let steps = self.steps();
        self.end(lock, steps, Some(segments))
    }

    /// Takes the lock, reads what others wrote, and checks that the client knows it.
    fn begin(&mut self, base: u64, patience: Duration) -> Result<RunLock, ChangeError> {
        self.refuse()?;
        if self.newer.is_under_way() || self.unread().is_some() {
            return Err(ChangeError::Reading);
        }
        let lock = self.shown.run.lock(COMMAND, LockDuration::Short, patience)?;
        self.check(base)?;
        Ok(lock)
    }

    /// Ends a change, before which there were these `steps`.
    fn end(&mut self, lock: RunLock, steps: [StepCounts; 2], segments: Option<RunSegments>) -> Result<(), ChangeError> {
        let mut names = Vec::new();
        if let Some(mut segments) = segments {
            segments.save()?;
            names = renamed(self.shown.segments.now(), segments.now());
            self.shown.segments = segments;
            // edits of a renamed segment now have its new name
            self.shown.edits = self.shown.run.edits()?;
        }
        let before = std::mem::replace(&mut self.shown.seen, stamps(&self.shown.run));
        self.note(steps, before);
        (self.renamed, self.revision) = (names, self.revision + 1);
        drop(lock);
        Ok(())
    }

    /// Returns the change that undoes or redoes what was changed last.
    fn last(&self, undo: bool) -> Result<Change, RunError> {
        let [segments, edits] = self.steps();
        let found = if undo { self.order.to_undo(segments, edits) } else { self.order.to_redo(segments, edits) };
        match found {
            Some(HistoryStack::Segments) => Ok(Change::Segments { undo }),
            Some(HistoryStack::Edits) => Ok(Change::Edits { undo }),
            None => Err(RunError::input(if undo { "nothing to undo" } else { "nothing to redo" })),
        }
    }
}

/// Replaces all segments by segments by colour at `time`.
///
/// # Errors
/// A time outside [0, 1], or one at which nothing is visible.
pub fn coarse(run: &OpenRun, segments: &mut RunSegments, time: f64, clusters: Option<usize>) -> Result<(), RunError> {
    if !(0.0..=1.0).contains(&time) {
        return Err(RunError::input("time: must be between 0 and 1"));
    }
    let at = run.scene.host_at(time as f32);
    let mut config = run.config.segment.clone();
    config.colour.clusters = clusters.unwrap_or(config.colour.clusters);
    if segments.coarse(run, &at, time, &config, 0)?.palette.is_empty() {
        return Err(RunError::input("no segments: nothing is visible at this time"));
    }
    Ok(())
}
