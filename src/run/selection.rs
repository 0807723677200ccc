//! Which Gaussians are shown: all or some segments, with or without the edits of the run.

use super::edits::check_names;
use super::{OpenRun, RunError};
use crate::edit::{Edit, EditError, EditStack, HIDDEN_LOGIT, apply, centre};
use crate::model::{HostGaussians, Scene};
use crate::segment::segmentation::Segmentation;
use crate::shell;

/// The part of a scene that is shown, with its files read and its names checked.
#[derive(Debug, Clone)]
pub struct Selection {
    segments: Segmentation,
    edits: EditStack,
    /// Edits to apply after those, not in any file.
    preview: Vec<Edit>,
    members: Option<Vec<u32>>,
    /// Hidden, whatever the edits say.
    hidden: Vec<u32>,
}

/// Checks that the segments of all edits still exist.
///
/// # Errors
/// The first edit whose segment does not, and what to do about it.
pub(super) fn check_edits(run: &OpenRun, edits: &EditStack, segments: &Segmentation) -> Result<(), RunError> {
    let known = |name: &str| segments.get(name).is_ok();
    edits.validate(&known).map_err(|e| {
        let file = run.paths().edits();
        let EditError::UnknownSegment { edit, name } = &e else {
            return RunError::input(format!("{}: {e}", file.display()));
        };
        RunError::input(format!(
            "{}: edit {edit} ({}): there is no longer a segment \"{name}\"; make one of that name, or undo the \
             edits from this one on with `volseggs edit undo {} --count {}`",
            file.display(),
            edits.operations[edit - 1],
            shell::path(&run.path),
            edits.operations.len() - edit + 1
        ))
    })
}

impl Selection {
    /// Selects the segments of these names alone, or the whole scene if there are none; applies the run's edits if
    /// `edited`.
    ///
    /// # Errors
    /// If a name is unknown, the segment of an edit no longer exists, or a file is damaged.
    pub fn open(run: &OpenRun, names: &[String], edited: bool) -> Result<Self, RunError> {
        Self::of(run, names, edited, false)
    }

    /// Like [`Selection::open`], for names from another run: those that this run does not have select nothing.
    ///
    /// # Errors
    /// As for [`Selection::open`], except for names.
    pub fn open_known(run: &OpenRun, names: &[String], edited: bool) -> Result<Self, RunError> {
        Self::of(run, names, edited, true)
    }

    fn of(run: &OpenRun, names: &[String], edited: bool, lenient: bool) -> Result<Self, RunError> {
        let edits = if edited { run.edits()? } else { EditStack::default() };
        let segments = if names.is_empty() && edits.operations.is_empty() {
            // nothing to look up: a file of segments that does not match the scene must not stop a plain render
            run.no_segments()
        } else {
            run.segments()?
        };
        check_edits(run, &edits, &segments).map_err(|e| RunError::input(format!("{e}; or pass --no-edits")))?;
        let members = if names.is_empty() {
            None
        } else {
            let mut all = Vec::new();
            for name in names {
                match segments.get(name) {
                    Ok(segment) => all.extend_from_slice(&segment.members),
                    Err(_) if lenient => {}
                    Err(error) => return Err(RunError::input(error)),
                }
            }
            all.sort_unstable();
            all.dedup();
            Some(all)
        };
        Ok(Self { segments, edits, preview: Vec::new(), members, hidden: Vec::new() })
    }

    /// Returns this selection without these Gaussians; this is not an edit, only a way of viewing the scene.
    #[must_use]
    pub fn hiding(mut self, members: Vec<u32>) -> Self {
        self.hidden = members;
        self
    }

    /// Applies `edits` after those of the run, instead of an earlier preview, to show what they would do. No file
    /// changes.
    ///
    /// # Errors
    /// If a value is out of range, a name is unknown, or a segment has no Gaussians.
    pub fn preview(&mut self, run: &OpenRun, edits: Vec<Edit>) -> Result<(), RunError> {
        if self.segments.segments.is_empty() && !edits.is_empty() {
            self.segments = run.segments()?;
        }
        for edit in &edits {
            edit.validate().map_err(RunError::input)?;
            check_names(&self.segments, edit)?;
        }
        self.preview = edits;
        Ok(())
    }

    /// Returns whether there is a preview.
    pub fn has_preview(&self) -> bool {
        !self.preview.is_empty()
    }

    /// Returns how many of the run's edits are applied.
    pub fn edits(&self) -> usize {
        self.edits.operations.len()
    }

    /// Returns whether this is the whole scene as trained.
    pub fn is_plain(&self) -> bool {
        self.members.is_none() && self.edits.operations.is_empty() && self.preview.is_empty() && self.hidden.is_empty()
    }

    /// Returns the indices shown, or `None` for all.
    pub fn members(&self) -> Option<&[u32]> {
        self.members.as_deref()
    }

    /// Returns all N Gaussians at `time` in [0, 1] with the edits applied; none are removed, though some may be hidden.
    ///
    /// # Errors
    /// If an edit cannot be applied.
    pub fn edited(&self, scene: &Scene, time: f32) -> Result<HostGaussians, RunError> {
        self.edit(scene.host_at(time))
    }

    /// Like [`Selection::edited`], for Gaussians `at` a time to which no edit was applied yet.
    ///
    /// # Errors
    /// If an edit cannot be applied.
    pub fn edit(&self, mut at: HostGaussians) -> Result<HostGaussians, RunError> {
        let members = |name: &str| self.segments.get(name).ok().map(|s| s.members.as_slice());
        let mut edits = self.edits.clone();
        edits.operations.extend_from_slice(&self.preview);
        apply(&edits, &members, &mut at).map_err(RunError::input)?;
        for &i in &self.hidden {
            at.opacity_logits[i as usize] = HIDDEN_LOGIT;
        }
        Ok(at)
    }

    /// Returns the Gaussians shown at `time` in [0, 1]: edited, then reduced to the selected segments.
    ///
    /// # Errors
    /// If an edit cannot be applied.
    pub fn gaussians_at(&self, scene: &Scene, time: f32) -> Result<HostGaussians, RunError> {
        Ok(self.cut(self.edited(scene, time)?))
    }

    /// Returns the opacity-weighted centre of the selection at `time` in [0, 1], with edits applied, in scene units: an
    /// edit rotates and scales a segment about it. `None` if nothing is selected.
    ///
    /// # Errors
    /// If an edit cannot be applied.
    pub fn centre(&self, scene: &Scene, time: f32) -> Result<Option<[f64; 3]>, RunError> {
        let before = scene.host_at(time);
        let now = self.edit(before.clone())?;
        Ok(match &self.members {
            Some(members) => centre(&before, &now, members),
            None => centre(&before, &now, &(0..before.len() as u32).collect::<Vec<_>>()),
        })
    }

    /// Reduces all N Gaussians to those of the selected segments.
    pub fn cut(&self, all: HostGaussians) -> HostGaussians {
        match &self.members {
            Some(members) => all.subset(members),
            None => all,
        }
    }

    /// Like [`Selection::gaussians_at`], without the Gaussians that edits hide: for files, whose readers would keep them.
    ///
    /// # Errors
    /// If an edit cannot be applied.
    pub fn visible(&self, scene: &Scene, time: f32) -> Result<HostGaussians, RunError> {
        let at = self.gaussians_at(scene, time)?;
        if self.edits.operations.is_empty() && self.preview.is_empty() {
            return Ok(at);
        }
        let kept: Vec<u32> =
            (0..).zip(&at.opacity_logits).filter(|(_, o)| **o != HIDDEN_LOGIT).map(|(i, _)| i).collect();
        Ok(at.subset(&kept))
    }
}
