//! Which Gaussians a command shows: all or some segments, with or without the edits of the run.

use super::CliError;
use super::run_folder::RunFolder;
use crate::edit::{EditError, EditStack, HIDDEN_LOGIT, apply};
use crate::model::{GaussiansAt, Scene};
use crate::segment::segmentation::Segmentation;
use clap::Args;

/// Name of the file of edits within a run folder.
pub(super) const EDITS: &str = "edits.json";

/// What of a scene to show.
#[derive(Debug, Clone, Args)]
pub(super) struct Shown {
    /// Show this segment alone; may be given many times.
    #[arg(long = "segment", value_name = "NAME")]
    pub segments: Vec<String>,
    /// Leave out the edits of the run.
    #[arg(long)]
    pub no_edits: bool,
}

/// [`Shown`] with its files read and its names checked.
pub(super) struct Selection {
    segments: Segmentation,
    edits: EditStack,
    members: Option<Vec<u32>>,
}

impl Shown {
    /// Reads the run's segments and edits.
    ///
    /// # Errors
    /// A name that no segment has, or a file that is damaged.
    pub(super) fn select(&self, run: &RunFolder) -> Result<Selection, CliError> {
        let edits = if self.no_edits { EditStack::default() } else { run.edits()? };
        let segments = if self.segments.is_empty() && edits.operations.is_empty() {
            // nothing to look up: a file of segments that does not fit the scene must not stop a plain render
            Segmentation::new(run.scene.gaussians.count(), run.scene.fingerprint())
        } else {
            run.segments()?
        };
        check_edits(run, &edits, &segments).map_err(|e| CliError::input(format!("{e}; or pass --no-edits")))?;
        let members = if self.segments.is_empty() {
            None
        } else {
            let mut all = Vec::new();
            for name in &self.segments {
                all.extend_from_slice(&segments.get(name).map_err(CliError::input)?.members);
            }
            all.sort_unstable();
            all.dedup();
            Some(all)
        };
        Ok(Selection { segments, edits, members })
    }
}

/// Refuses edits of segments that are not there any more.
///
/// # Errors
/// The first such edit, and the way out.
pub(super) fn check_edits(run: &RunFolder, edits: &EditStack, segments: &Segmentation) -> Result<(), CliError> {
    let known = |name: &str| segments.get(name).is_ok();
    edits.validate(&known).map_err(|e| {
        let file = run.path.join(EDITS);
        let EditError::UnknownSegment { edit, name } = &e else {
            return CliError::input(format!("{}: {e}", file.display()));
        };
        CliError::input(format!(
            "{}: edit {edit} ({}): there is no segment \"{name}\" any more; make one of that name, or take edits back \
             to before it with `volseggs edit undo {} --count {}`",
            file.display(),
            edits.operations[edit - 1],
            run.path.display(),
            edits.operations.len() - edit + 1
        ))
    })
}

impl Selection {
    /// True if it is the whole scene as trained.
    pub(super) fn is_plain(&self) -> bool {
        self.members.is_none() && self.edits.operations.is_empty()
    }

    /// The indices shown, if not all.
    pub(super) fn members(&self) -> Option<&[u32]> {
        self.members.as_deref()
    }

    /// All N Gaussians at `time` in [0, 1] with the edits applied; nothing is left out.
    ///
    /// # Errors
    /// If an edit cannot be applied.
    pub(super) fn edited(&self, scene: &Scene, time: f32) -> Result<GaussiansAt, CliError> {
        let mut at = scene.host_at(time);
        let members = |name: &str| self.segments.get(name).ok().map(|s| s.members.as_slice());
        apply(&self.edits, &members, &mut at).map_err(CliError::input)?;
        Ok(at)
    }

    /// The Gaussians shown at `time` in [0, 1]: edited, then those of the segments alone.
    ///
    /// # Errors
    /// If an edit cannot be applied.
    pub(super) fn at(&self, scene: &Scene, time: f32) -> Result<GaussiansAt, CliError> {
        Ok(self.cut(self.edited(scene, time)?))
    }

    /// Of all N Gaussians those of the segments alone.
    pub(super) fn cut(&self, all: GaussiansAt) -> GaussiansAt {
        match &self.members {
            Some(members) => all.subset(members),
            None => all,
        }
    }

    /// As [`Selection::at`], without the Gaussians that edits hide: for files, whose readers would keep them.
    ///
    /// # Errors
    /// If an edit cannot be applied.
    pub(super) fn visible(&self, scene: &Scene, time: f32) -> Result<GaussiansAt, CliError> {
        let at = self.at(scene, time)?;
        if self.edits.operations.is_empty() {
            return Ok(at);
        }
        let kept: Vec<u32> =
            (0..).zip(&at.opacity_logits).filter(|(_, o)| **o != HIDDEN_LOGIT).map(|(i, _)| i).collect();
        Ok(at.subset(&kept))
    }
}
