//! The run that is viewed, with its segments and edits: one document for all clients, and for commands that write into the
//! run meanwhile.

use super::order::{Order, Stack, Steps};
use super::protocol::{Change, Document, SegmentRow};
use super::training::{Stamp, stamp};
use crate::edit::{Edit, EditStack, Total};
use crate::files::{RunLock, Work};
use crate::run::segments::{RunSegments, Towards};
use crate::run::selection::Selection;
use crate::run::{OpenRun, RunError, affinity, edits, pick};
use crate::segment::coarse::CoarseOptions;
use crate::segment::fine::AffinityField;
use crate::segment::fine::file::AffinitySpec;
use crate::segment::pick::Picked;
use crate::train::checkpoint;
use burn::tensor::Device;
use std::path::{Path, PathBuf};

/// What others are told of who holds the run.
const COMMAND: &str = "volseggs view";

/// Why a change is refused.
#[derive(Debug, thiserror::Error)]
pub enum ChangeError {
    /// Somebody else changed the document before.
    #[error("segments or edits were changed meanwhile; look at them and try again")]
    Stale,
    /// Nothing may be changed.
    #[error("this viewer was started with --read-only")]
    ReadOnly,
    /// It cannot be done.
    #[error(transparent)]
    Run(#[from] RunError),
}

/// The run, its segments and edits.
#[derive(Debug)]
pub struct Workspace {
    /// The run.
    pub run: OpenRun,
    /// Its device.
    pub device: Device,
    /// Whether newer checkpoints take its place: the run was opened, not one of its checkpoints.
    follows: bool,
    /// The newest checkpoint that was seen.
    newest: Option<PathBuf>,
    segments: RunSegments,
    /// Why the segments on the disk cannot be used with this scene, if they cannot.
    fault: Option<String>,
    edits: EditStack,
    field: Option<(AffinityField, AffinitySpec)>,
    revision: u64,
    /// Which of segments and edits changed last.
    order: Order,
    /// What the files looked like when they were read.
    seen: Seen,
    read_only: bool,
}

/// Stamps of the files of segments, edits and affinity field.
type Seen = [Stamp; 3];

impl Workspace {
    /// Opens a run, which may be training: its newest checkpoint is shown. Segments of another state of its scene are left
    /// out.
    ///
    /// # Errors
    /// If the run or a file of it cannot be used.
    pub fn open(path: &Path, device: &Device, read_only: bool) -> Result<Self, RunError> {
        let run = OpenRun::open(path, device)?;
        let seen = seen(&run);
        let ((segments, fault), edits) = (RunSegments::replacing(&run), run.edits()?);
        let (fault, field) = (fault.map(|e| e.to_string()), field(&run, device));
        let (device, follows) = (device.clone(), checkpoint::locate(path).0 == path);
        let newest = run.scene_path.parent().map(Path::to_owned);
        let order = Order::default();
        Ok(Self { run, device, follows, newest, segments, fault, edits, field, revision: 1, order, seen, read_only })
    }

    /// Grows with every change of segments or edits.
    #[must_use]
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Why the segments on the disk are not there, if they cannot be used; nothing can be changed then.
    #[must_use]
    pub fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }

    /// Whether nothing may be changed.
    #[must_use]
    pub fn read_only(&self) -> bool {
        self.read_only
    }

    /// The affinity field, if there is one.
    #[must_use]
    pub fn field(&self) -> Option<&(AffinityField, AffinitySpec)> {
        self.field.as_ref()
    }

    /// The segments.
    #[must_use]
    pub fn segments(&self) -> &RunSegments {
        &self.segments
    }

    /// Reads what commands and a training wrote meanwhile; whether there was any. What cannot be read leaves all as it was.
    ///
    /// # Errors
    /// If a file is damaged now.
    pub fn refresh(&mut self) -> Result<bool, RunError> {
        let newest = if self.follows { checkpoint::list(&self.run.path).pop().map(|(_, path)| path) } else { None };
        if newest.is_some() && newest != self.newest {
            // one that cannot be read is told of once
            self.newest = newest;
            self.reload()?;
            return Ok(true);
        }
        let now = seen(&self.run);
        if now == self.seen {
            return Ok(false);
        }
        // told once, not at every look at the files
        let before = std::mem::replace(&mut self.seen, now);
        let steps = self.steps();
        (self.segments, self.edits) = (RunSegments::open(&self.run)?, self.run.edits()?);
        self.note(steps, before);
        self.fault = None;
        self.field = field(&self.run, &self.device);
        self.revision += 1;
        Ok(true)
    }

    /// Shows the newest checkpoint in place of the one that is shown. Checkpoints appear whole, by a change of their name, so
    /// that none is read half.
    fn reload(&mut self) -> Result<(), RunError> {
        let run = OpenRun::open(&self.run.path, &self.device)?;
        let (seen, edits) = (seen(&run), run.edits()?);
        let (segments, fault) = RunSegments::replacing(&run);
        self.field = field(&run, &self.device);
        self.newest = run.scene_path.parent().map(Path::to_owned);
        (self.run, self.seen, self.edits, self.segments) = (run, seen, edits, segments);
        // what was changed before was of another state of the scene
        self.order = Order::default();
        self.fault = fault.map(|e| e.to_string());
        self.revision += 1;
        Ok(())
    }

    /// Carries out a change of a client that knows revision `base`.
    ///
    /// # Errors
    /// If the document has another revision by now, or it cannot be done; all is then as it was.
    pub fn change(&mut self, base: u64, change: &Change) -> Result<(), ChangeError> {
        let lock = self.begin(base)?;
        let towards = |undo: bool| if undo { Towards::Undo } else { Towards::Redo };
        let steps = self.steps();
        let mut segments = self.segments.clone();
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
                self.edits = edits::push(&self.run, edit)?;
                return self.end(lock, steps, None);
            }
            Change::Edits { undo } => {
                self.edits = edits::step(&self.run, towards(*undo), 1)?;
                return self.end(lock, steps, None);
            }
            Change::Coarse { time, clusters } => {
                if !(0.0..=1.0).contains(time) {
                    return Err(RunError::input("time: between 0 and 1").into());
                }
                let at = self.run.scene.host_at(*time as f32);
                let options = CoarseOptions { clusters: *clusters, ..CoarseOptions::default() };
                let found = segments.coarse(&self.run, &at, *time, &options)?;
                if found.palette.is_empty() {
                    return Err(RunError::input("no segments: nothing shows at this time").into());
                }
            }
            Change::Group { name, segments: of } => segments.group(name, of)?,
            Change::Rename { segment, name } => segments.rename(&self.run, segment, name)?,
            Change::Remove { segments: of } => drop(segments.remove(of)?),
            Change::Segments { undo } => drop(segments.step(towards(*undo), 1)?),
            Change::Last { .. } => {}
        }
        self.end(lock, steps, Some(segments))
    }

    /// Makes a segment of what clicks selected, for a client that knows revision `base`.
    ///
    /// # Errors
    /// As [`Workspace::change`].
    pub fn commit(
        &mut self,
        base: u64,
        name: &crate::name::Name,
        hit: &pick::Hit,
        picked: &Picked,
        time: f64,
    ) -> Result<(), ChangeError> {
        let lock = self.begin(base)?;
        let (steps, mut segments) = (self.steps(), self.segments.clone());
        pick::commit(&self.run, &mut segments, name, hit, picked, time)?;
        self.end(lock, steps, Some(segments))
    }

    /// The run for long work on another thread, which is to lock it, for a client that knows revision `base`.
    ///
    /// # Errors
    /// If nothing may be changed, or the document has another revision by now.
    pub fn for_work(&mut self, base: u64) -> Result<OpenRun, ChangeError> {
        if self.read_only {
            return Err(ChangeError::ReadOnly);
        }
        self.check(base)?;
        Ok(self.run.share())
    }

    /// Takes the lock, reads what others wrote, and checks that the client knows it.
    fn begin(&mut self, base: u64) -> Result<RunLock, ChangeError> {
        if self.read_only {
            return Err(ChangeError::ReadOnly);
        }
        let lock = self.run.lock(COMMAND, Work::Short)?;
        self.check(base)?;
        Ok(lock)
    }

    /// Reads what others wrote, and refuses a client that does not know it.
    fn check(&mut self, base: u64) -> Result<(), ChangeError> {
        self.refresh()?;
        match &self.fault {
            _ if self.revision != base => Err(ChangeError::Stale),
            Some(fault) => Err(RunError::input(fault).into()),
            None => Ok(()),
        }
    }

    /// Ends a change, before which there were these `steps`.
    fn end(&mut self, lock: RunLock, steps: [Steps; 2], segments: Option<RunSegments>) -> Result<(), ChangeError> {
        if let Some(mut segments) = segments {
            segments.save()?;
            self.segments = segments;
            // those of a segment that has another name now followed
            self.edits = self.run.edits()?;
        }
        let before = std::mem::replace(&mut self.seen, seen(&self.run));
        self.note(steps, before);
        self.revision += 1;
        drop(lock);
        Ok(())
    }

    /// Steps to undo and redo of segments and edits.
    fn steps(&self) -> [Steps; 2] {
        let of = |towards| self.segments.steps(towards).len();
        let segments = Steps { undo: of(Towards::Undo), redo: of(Towards::Redo) };
        [segments, Steps { undo: self.edits.operations.len(), redo: self.edits.undone.len() }]
    }

    /// Notes which of the two histories changed since there were these steps and the files looked like `before`; of both
    /// the one whose file was written first.
    fn note(&mut self, [segments, edits]: [Steps; 2], before: Seen) {
        let now = self.steps();
        let mut changed = [(Stack::Segments, 0, segments, now[0]), (Stack::Edits, 1, edits, now[1])];
        changed.sort_by_key(|(_, file, ..)| self.seen[*file]);
        for (stack, file, before_it, after_it) in changed {
            // edits that only follow a new name are no change of theirs
            let only_names = stack == Stack::Edits && before_it == after_it;
            if self.seen[file] != before[file] && !only_names {
                self.order.saw(stack, before_it, after_it);
            }
        }
    }

    /// The change that undoes or redoes what was changed last.
    fn last(&self, undo: bool) -> Result<Change, RunError> {
        let [segments, edits] = self.steps();
        let found = if undo { self.order.to_undo(segments, edits) } else { self.order.to_redo(segments, edits) };
        match found {
            Some(Stack::Segments) => Ok(Change::Segments { undo }),
            Some(Stack::Edits) => Ok(Change::Edits { undo }),
            None => Err(RunError::input(if undo { "nothing to undo" } else { "nothing to redo" })),
        }
    }

    /// Where segments are at `time` in [0, 1], edits applied: their opacity-weighted centre in world units.
    ///
    /// # Errors
    /// A time out of range, no segments, a name that none has, or segments that hold no Gaussians.
    pub fn centre(&self, segments: &[String], time: f64) -> Result<[f64; 3], RunError> {
        if !(0.0..=1.0).contains(&time) {
            return Err(RunError::input("time: between 0 and 1"));
        }
        if segments.is_empty() {
            return Err(RunError::input("segments: name at least one"));
        }
        let centre = Selection::open(&self.run, segments, true)?.centre(&self.run.scene, time as f32)?;
        centre.ok_or_else(|| RunError::input(format!("{}: no Gaussians", segments.join(", "))))
    }

    /// What clients are told.
    #[must_use]
    pub fn document(&self) -> Document {
        let row = |(depth, s): (usize, &crate::segment::segmentation::Segment)| {
            let Total { rgb, opacity, hidden } = self.edits.total(&s.name);
            let (name, gaussians) = (s.name.to_string(), s.members.len());
            SegmentRow { name, depth, colour: s.colour, gaussians, time: s.time, rgb, opacity, hidden }
        };
        let step = |towards| self.segments.steps(towards).first().map(|s| (*s).to_owned());
        Document {
            revision: self.revision,
            segments: self.segments.now().tree().into_iter().map(row).collect(),
            edits: self.edits.operations.iter().map(ToString::to_string).collect(),
            segment_steps: [step(Towards::Undo), step(Towards::Redo)],
            edit_steps: [!self.edits.operations.is_empty(), !self.edits.undone.is_empty()],
        }
    }
}

fn seen(run: &OpenRun) -> Seen {
    let paths = run.paths();
    [paths.segments(), paths.edits(), paths.affinity()].map(|path| stamp(&path))
}

/// A field that cannot be used is none: the viewer then says how to make one.
fn field(run: &OpenRun, device: &Device) -> Option<(AffinityField, AffinitySpec)> {
    affinity::open(run, device).ok()
}
