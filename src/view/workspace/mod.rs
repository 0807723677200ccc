//! The viewed run with its segments and edits: one document for all clients and for commands that write to the run.

mod change;
mod document;

pub use change::coarse;

use super::live::Live;
use super::order::{ChangeOrder, HistoryStack, StepCounts};
use super::reading::{FileStamps, NewerCheckpoint, OpenedRun, field, stamps};
use super::refusal::ChangeError;
use crate::run::segments::{HistoryDirection, RunSegments};
use crate::run::{OpenRun, RunError};
use crate::segment::segmentation::renamed;
use crate::train::checkpoint;
use burn::tensor::Device;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The run, its segments and edits.
#[derive(Debug)]
pub struct Workspace {
    /// The run with all that is shown of it, as it was read last or changed since.
    pub shown: OpenedRun,
    /// Whether newer checkpoints replace it: the run was opened, not one of its checkpoints.
    follows: bool,
    /// The newest checkpoint that was seen.
    newest: Option<PathBuf>,
    newer: NewerCheckpoint,
    /// Why what was written since cannot be read, if so; what was read before is shown, and nothing can be changed.
    damage: Option<String>,
    revision: u64,
    /// Old and new names of segments that the last change renamed.
    renamed: Vec<[String; 2]>,
    /// The order in which segments and edits changed.
    order: ChangeOrder,
    read_only: bool,
    /// The training of the run, if it goes on in this process.
    live: Option<Arc<Live>>,
}

impl Workspace {
    /// Opens a run, which may still be training: its newest checkpoint is shown. Segments of another state of its scene
    /// are omitted.
    ///
    /// # Errors
    /// If the run or a file of it cannot be used.
    pub fn open(path: &Path, data: Option<&Path>, device: &Device, read_only: bool) -> Result<Self, RunError> {
        let read = OpenedRun::new(path, data, device)?;
        let newest = read.run.scene_path.parent().map(Path::to_owned);
        let follows = checkpoint::locate(path).0 == path;
        Ok(Self { newest, follows, ..Self::showing(read, read_only) })
    }

    fn showing(shown: OpenedRun, read_only: bool) -> Self {
        Self {
            shown,
            follows: false,
            newest: None,
            newer: NewerCheckpoint::default(),
            damage: None,
            revision: 1,
            renamed: Vec::new(),
            order: ChangeOrder::default(),
            read_only,
            live: None,
        }
    }

    /// Makes the workspace of a run that this process trains. It shows the scenes that the trainer leaves; there are no
    /// segments and edits, whatever files say, as those would belong to another state of the scene.
    pub fn in_training(run: OpenRun, live: Arc<Live>, read_only: bool) -> Self {
        live.shows(run.step().unwrap_or_default(), run.scene.gaussians.count());
        Self { live: Some(live), ..Self::showing(OpenedRun::scene_alone(run), read_only) }
    }

    /// Returns a number that grows with every change of the scene, segments or edits.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Whether segments and edits of the run can be shown.
    pub fn has_document(&self) -> bool {
        self.shown.fault.is_none() && self.live.is_none()
    }

    /// Whether segments and edits cannot be changed.
    pub fn read_only(&self) -> bool {
        self.refuse().is_err()
    }

    /// Refuses changes where none are possible.
    ///
    /// # Errors
    /// Why none are possible.
    pub fn refuse(&self) -> Result<(), ChangeError> {
        match self.live {
            _ if self.read_only => Err(ChangeError::ReadOnly),
            Some(_) => Err(ChangeError::InTraining),
            None => Ok(()),
        }
    }

    /// Returns the training of the run, if it goes on in this process.
    pub fn live(&self) -> Option<&Arc<Live>> {
        self.live.as_ref()
    }

    /// Returns the training of the run, to pause or continue it.
    ///
    /// # Errors
    /// If there is none, or nothing may be changed.
    pub fn can_pause(&self) -> Result<&Live, ChangeError> {
        match &self.live {
            _ if self.read_only => Err(ChangeError::ReadOnly),
            Some(live) => Ok(live),
            None => Err(ChangeError::NoTraining),
        }
    }

    /// Reads what commands and a training wrote meanwhile; returns whether there was anything. A newer checkpoint is
    /// read on another thread, and shown at a later call. If something cannot be read, everything stays as it was.
    ///
    /// # Errors
    /// If a file is damaged now.
    pub fn refresh(&mut self) -> Result<bool, RunError> {
        if let Some(live) = &self.live {
            let Some(copy) = live.take() else { return Ok(false) };
            let (scene, step) = copy.open(&self.shown.run.device()).map_err(RunError::failure)?;
            live.shows(step, scene.gaussians.count());
            self.shown.run.advance(scene, step);
            self.revision += 1;
            return Ok(true);
        }
        if let Some(read) = self.newer.take() {
            self.show(read?);
            return Ok(true);
        }
        if let Some(newest) = self.unread() {
            // one that cannot be read is reported once
            self.newest = Some(newest);
            self.newer.begin(&self.shown.run)?;
        }
        if self.newer.is_under_way() {
            // what the files hold may belong to that state of the scene
            return Ok(false);
        }
        let now = stamps(&self.shown.run);
        if now == self.shown.seen {
            return Ok(false);
        }
        // reported once, not at every check of the files
        let before = std::mem::replace(&mut self.shown.seen, now);
        let steps = self.steps();
        let read = RunSegments::open(&self.shown.run).and_then(|segments| Ok((segments, self.shown.run.edits()?)));
        // what was not read must not be overwritten
        self.damage = read.as_ref().err().map(ToString::to_string);
        let (segments, edits) = read?;
        self.renamed = renamed(self.shown.segments.now(), segments.now());
        (self.shown.segments, self.shown.edits) = (segments, edits);
        self.note(steps, before);
        self.shown.fault = None;
        self.shown.field = field(&self.shown.run);
        self.revision += 1;
        Ok(true)
    }

    /// The newest checkpoint, if it was not seen before and is to be shown. Checkpoints appear whole, by renaming, so
    /// that none is read half-written.
    fn unread(&self) -> Option<PathBuf> {
        if !self.follows || self.newer.is_under_way() {
            return None;
        }
        let (_, newest) = checkpoint::list(&self.shown.run.path).pop()?;
        (self.newest.as_ref() != Some(&newest)).then_some(newest)
    }

    /// Shows a newer checkpoint instead of the current one.
    fn show(&mut self, read: OpenedRun) {
        self.newest = read.run.scene_path.parent().map(Path::to_owned);
        self.shown = read;
        // earlier changes belong to another state of the scene
        (self.order, self.renamed, self.damage) = (ChangeOrder::default(), Vec::new(), None);
        self.revision += 1;
    }

    /// Returns the run for long work on another thread, which must lock it, for a client that knows revision `base`.
    ///
    /// # Errors
    /// If nothing may be changed, or the document has another revision by now.
    pub fn for_work(&mut self, base: u64) -> Result<OpenRun, ChangeError> {
        self.refuse()?;
        self.check(base)?;
        Ok(self.shown.run.share())
    }

    /// Reads what others wrote, and refuses a client that does not know it.
    fn check(&mut self, base: u64) -> Result<(), ChangeError> {
        self.refresh()?;
        match &self.shown.fault {
            _ if self.revision != base => Err(ChangeError::Stale),
            _ if self.newer.is_under_way() => Err(ChangeError::Reading),
            Some(fault) => Err(RunError::input(fault).into()),
            None => self.damage.as_ref().map_or(Ok(()), |fault| Err(RunError::input(fault).into())),
        }
    }

    /// Numbers of steps to undo and redo, of segments and edits.
    fn steps(&self) -> [StepCounts; 2] {
        let of = |towards| self.shown.segments.steps(towards).len();
        let segments = StepCounts { undo: of(HistoryDirection::Undo), redo: of(HistoryDirection::Redo) };
        [segments, StepCounts { undo: self.shown.edits.operations.len(), redo: self.shown.edits.undone.len() }]
    }

    /// Records which of the two histories changed since they had these steps and the files had the stamps `before`; if
    /// both did, first the one whose file was written first.
    fn note(&mut self, [segments, edits]: [StepCounts; 2], before: FileStamps) {
        let now = self.steps();
        let mut changed = [(HistoryStack::Segments, 0, segments, now[0]), (HistoryStack::Edits, 1, edits, now[1])];
        changed.sort_by_key(|(_, file, ..)| self.shown.seen[*file]);
        for (stack, file, before_it, after_it) in changed {
            // edits that were only adapted to a new name have not changed
            let only_names = stack == HistoryStack::Edits && before_it == after_it;
            if self.shown.seen[file] != before[file] && !only_names {
                self.order.record(stack, before_it, after_it);
            }
        }
    }
}
