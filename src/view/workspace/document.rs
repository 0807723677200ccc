//! What clients are told about the viewed run.

use super::Workspace;
use crate::edit::CombinedEdit;
use crate::run::RunError;
use crate::run::segments::HistoryDirection;
use crate::run::selection::Selection;
use crate::segment::segmentation::Segment;
use crate::view::protocol::{Document, SegmentRow};

impl Workspace {
    /// Returns the opacity-weighted centre of segments at `time` in [0, 1], edits applied, in scene units.
    ///
    /// # Errors
    /// A time out of range, no segments, an unknown name, or segments without Gaussians.
    pub fn centre(&self, segments: &[String], time: f64) -> Result<[f64; 3], RunError> {
        if !(0.0..=1.0).contains(&time) {
            return Err(RunError::input("time: must be between 0 and 1"));
        }
        if segments.is_empty() {
            return Err(RunError::input("segments: name at least one"));
        }
        let centre = Selection::open(&self.shown.run, segments, true)?.centre(&self.shown.run.scene, time as f32)?;
        centre.ok_or_else(|| RunError::input(format!("{}: no Gaussians", segments.join(", "))))
    }

    /// Returns what clients are told.
    pub fn document(&self) -> Document {
        let row = |(depth, s): (usize, &Segment)| {
            let CombinedEdit { rgb, opacity, hidden } = self.shown.edits.total(&s.name);
            let (name, gaussians) = (s.name.to_string(), s.members.len());
            SegmentRow { name, depth, colour: s.colour, gaussians, time: s.time, rgb, opacity, hidden }
        };
        let step = |towards| self.shown.segments.steps(towards).first().map(|s| (*s).to_owned());
        Document {
            revision: self.revision,
            renamed: self.renamed.clone(),
            segments: self.shown.segments.now().tree().into_iter().map(row).collect(),
            edits: self.shown.edits.operations.iter().map(|edit| edit.line(self.shown.run.calibration())).collect(),
            segment_steps: [step(HistoryDirection::Undo), step(HistoryDirection::Redo)],
            edit_steps: [!self.shown.edits.operations.is_empty(), !self.shown.edits.undone.is_empty()],
        }
    }
}
