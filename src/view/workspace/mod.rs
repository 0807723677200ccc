//! The viewed run with its segments and edits: one document for all clients and for commands that write to the run.

mod change;
mod document;

pub use change::coarse;

use super::live::Live;
use super::order::{Order, Stack, Steps};
use super::reading::{Newer, Read, Stamps, field, stamps};
use super::refusal::ChangeError;
use crate::data::Surroundings;
use crate::edit::EditStack;
use crate::run::segments::{RunSegments, Towards};
use crate::run::{OpenRun, RunError};
use crate::segment::fine::AffinityField;
use crate::segment::fine::file::AffinitySpec;
use crate::segment::segmentation::renamed;
use crate::train::checkpoint;
use burn::tensor::Device;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The run, its segments and edits.
#[derive(Debug)]
pub struct Workspace {
    /// The run.
    pub run: OpenRun,
    /// Where the cameras of its dataset are.
    pub around: Surroundings,
    /// Whether newer checkpoints replace it: the run was opened, not one of its checkpoints.
    follows: bool,
    /// The newest checkpoint that was seen.
    newest: Option<PathBuf>,
    newer: Newer,
    segments: RunSegments,
    /// Why the segments on disk cannot be used with this scene, if they cannot.
    fault: Option<String>,
    /// Why what was written since cannot be read, if so; what was read before is shown, and nothing can be changed.
    damage: Option<String>,
    edits: EditStack,
    field: Option<(AffinityField, AffinitySpec)>,
    revision: u64,
    /// Old and new names of segments that the last change renamed.
    renamed: Vec<[String; 2]>,
    /// The order in which segments and edits changed.
    order: Order,
    /// The stamps of the files when they were read.
    seen: Stamps,
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
        let read = Read::new(path, data, device)?;
        let newest = read.run.scene_path.parent().map(Path::to_owned);
        let follows = checkpoint::locate(path).0 == path;
        Ok(Self { newest, follows, ..Self::showing(read, read_only) })
    }

    fn showing(read: Read, read_only: bool) -> Self {
        let Read { run, around, seen, segments, fault, edits, field } = read;
        Self {
            run,
            around,
            follows: false,
            newest: None,
            newer: Newer::default(),
            segments,
            fault,
            damage: None,
            edits,
            field,
            revision: 1,
            renamed: Vec::new(),
            order: Order::default(),
            seen,
            read_only,
            live: None,
        }
    }

    /// Makes the workspace of a run that this process trains. It shows the scenes that the trainer leaves; there are no
    /// segments and edits, whatever files say, as those would belong to another state of the scene.
    #[must_use]
    pub fn in_training(run: OpenRun, live: Arc<Live>, read_only: bool) -> Self {
        live.shows(run.step().unwrap_or_default(), run.scene.gaussians.count());
        Self { live: Some(live), ..Self::showing(Read::scene_alone(run), read_only) }
    }

    /// Returns a number that grows with every change of the scene, segments or edits.
    #[must_use]
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Returns why the segments on disk cannot be used, if they cannot; nothing can be changed then.
    #[must_use]
    pub fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }

    /// Whether segments and edits of the run can be shown.
    #[must_use]
    pub fn has_document(&self) -> bool {
        self.fault.is_none() && self.live.is_none()
    }

    /// Whether segments and edits cannot be changed.
    #[must_use]
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
    #[must_use]
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

    /// Reads what commands and a training wrote meanwhile; returns whether there was anything. A newer checkpoint is
    /// read on another thread, and shown at a later call. If something cannot be read, everything stays as it was.
    ///
    /// # Errors
    /// If a file is damaged now.
    pub fn refresh(&mut self) -> Result<bool, RunError> {
        if let Some(live) = &self.live {
            let Some(copy) = live.take() else { return Ok(false) };
            let (scene, step) = copy.open(&self.run.device()).map_err(RunError::failure)?;
            live.shows(step, scene.gaussians.count());
            self.run.advance(scene, step);
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
            self.newer.begin(&self.run)?;
        }
        if self.newer.is_under_way() {
            // what the files hold may belong to that state of the scene
            return Ok(false);
        }
        let now = stamps(&self.run);
        if now == self.seen {
            return Ok(false);
        }
        // reported once, not at every check of the files
        let before = std::mem::replace(&mut self.seen, now);
        let steps = self.steps();
        let read = RunSegments::open(&self.run).and_then(|segments| Ok((segments, self.run.edits()?)));
        // what was not read must not be overwritten
        self.damage = read.as_ref().err().map(ToString::to_string);
        let (segments, edits) = read?;
        self.renamed = renamed(self.segments.now(), segments.now());
        (self.segments, self.edits) = (segments, edits);
        self.note(steps, before);
        self.fault = None;
        self.field = field(&self.run);
        self.revision += 1;
        Ok(true)
    }

    /// The newest checkpoint, if it was not seen before and is to be shown. Checkpoints appear whole, by renaming, so
    /// that none is read half-written.
    fn unread(&self) -> Option<PathBuf> {
        if !self.follows || self.newer.is_under_way() {
            return None;
        }
        let (_, newest) = checkpoint::list(&self.run.path).pop()?;
        (self.newest.as_ref() != Some(&newest)).then_some(newest)
    }

    /// Shows a newer checkpoint instead of the current one.
    fn show(&mut self, read: Read) {
        self.newest = read.run.scene_path.parent().map(Path::to_owned);
        Read {
            run: self.run,
            around: self.around,
            seen: self.seen,
            segments: self.segments,
            fault: self.fault,
            edits: self.edits,
            field: self.field,
        } = read;
        // earlier changes belong to another state of the scene
        (self.order, self.renamed, self.damage) = (Order::default(), Vec::new(), None);
        self.revision += 1;
    }

    /// Returns the run for long work on another thread, which must lock it, for a client that knows revision `base`.
    ///
    /// # Errors
    /// If nothing may be changed, or the document has another revision by now.
    pub fn for_work(&mut self, base: u64) -> Result<OpenRun, ChangeError> {
        self.refuse()?;
        self.check(base)?;
        Ok(self.run.share())
    }

    /// Reads what others wrote, and refuses a client that does not know it.
    fn check(&mut self, base: u64) -> Result<(), ChangeError> {
        self.refresh()?;
        match &self.fault {
            _ if self.revision != base => Err(ChangeError::Stale),
            _ if self.newer.is_under_way() => Err(ChangeError::Reading),
            Some(fault) => Err(RunError::input(fault).into()),
            None => self.damage.as_ref().map_or(Ok(()), |fault| Err(RunError::input(fault).into())),
        }
    }

    /// Numbers of steps to undo and redo, of segments and edits.
    fn steps(&self) -> [Steps; 2] {
        let of = |towards| self.segments.steps(towards).len();
        let segments = Steps { undo: of(Towards::Undo), redo: of(Towards::Redo) };
        [segments, Steps { undo: self.edits.operations.len(), redo: self.edits.undone.len() }]
    }

    /// Records which of the two histories changed since they had these steps and the files had the stamps `before`; if
    /// both did, first the one whose file was written first.
    fn note(&mut self, [segments, edits]: [Steps; 2], before: Stamps) {
        let now = self.steps();
        let mut changed = [(Stack::Segments, 0, segments, now[0]), (Stack::Edits, 1, edits, now[1])];
        changed.sort_by_key(|(_, file, ..)| self.seen[*file]);
        for (stack, file, before_it, after_it) in changed {
            // edits that were only adapted to a new name have not changed
            let only_names = stack == Stack::Edits && before_it == after_it;
            if self.seen[file] != before[file] && !only_names {
                self.order.record(stack, before_it, after_it);
            }
        }
    }
}
