//! The ordered edits with undo and redo. Nothing is applied here; files are read and written in `file`.

use super::error::EditError;
use super::operation::{Edit, Operation};
use crate::data::Calibration;
use serde::Serialize;

/// Edits in the order in which they apply, and those undone.
///
/// ```
/// use volseggs_segment::edit::{Edit, EditStack, Operation};
/// let mut edits = EditStack::default();
/// edits.push(Edit { segments: vec!["red".into()], operation: Operation::Hide })?;
/// edits.undo();
/// assert!(edits.operations.is_empty() && edits.undone.len() == 1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct EditStack {
    /// The edits that apply, first to last.
    pub operations: Vec<Edit>,
    /// The undone edits, the one undone last at the end.
    pub undone: Vec<Edit>,
}

/// The combined effect of the edits by one segment name. Those of wholes that it is a part of, of its parts, and of
/// other segments with the same Gaussians are not included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CombinedEdit {
    /// The last colour that it was given, RGB in [0, 1].
    pub rgb: Option<[f32; 3]>,
    /// Factor on its linear opacity.
    pub opacity: f32,
    /// Whether it is hidden.
    pub hidden: bool,
}

impl Default for CombinedEdit {
    fn default() -> Self {
        Self { rgb: None, opacity: 1.0, hidden: false }
    }
}

impl EditStack {
    /// Adds an edit at the end and discards those undone.
    ///
    /// # Errors
    /// [`EditError::Value`]; the stack is then unchanged.
    pub fn push(&mut self, edit: Edit) -> Result<(), EditError> {
        edit.validate()?;
        self.operations.push(edit);
        self.undone.clear();
        Ok(())
    }

    /// Undoes the last edit and returns it; `None` if there is none.
    pub fn undo(&mut self) -> Option<&Edit> {
        self.undone.push(self.operations.pop()?);
        self.undone.last()
    }

    /// Redoes the edit undone last and returns it; `None` if there is none.
    pub fn redo(&mut self) -> Option<&Edit> {
        self.operations.push(self.undone.pop()?);
        self.operations.last()
    }

    /// Replaces the segment name `old` by `new` everywhere; returns whether that changed anything.
    pub fn rename(&mut self, old: &str, new: &str) -> bool {
        let mut changed = false;
        let edits = self.operations.iter_mut().chain(&mut self.undone);
        for name in edits.flat_map(|e| &mut e.segments).filter(|name| *name == old) {
            new.clone_into(name);
            changed = true;
        }
        changed
    }

    /// Returns whether an edit, undone or not, names the segment.
    pub fn names(&self, segment: &str) -> bool {
        self.operations.iter().chain(&self.undone).any(|e| e.segments.iter().any(|name| name == segment))
    }

    /// Returns the combined effect of the edits by this segment name.
    pub fn total(&self, segment: &str) -> CombinedEdit {
        let mut total = CombinedEdit::default();
        for edit in self.operations.iter().filter(|e| e.segments.iter().any(|name| name == segment)) {
            match edit.operation {
                Operation::Recolour { rgb, .. } => total.rgb = Some(rgb),
                Operation::Opacity { factor: 0.0, .. } | Operation::Hide => total.hidden = true,
                Operation::Opacity { factor, show } => {
                    total.opacity *= factor;
                    total.hidden &= !show;
                }
                Operation::Show => total.hidden = false,
                _ => {}
            }
        }
        total
    }

    /// Returns a line for each edit, see [`Edit::line`], numbered from 1; undone ones follow in the order in which redo restores them.
    pub fn list(&self, calibration: &Calibration) -> Vec<String> {
        let undone = self.undone.iter().rev().map(|edit| (edit, " (undone)"));
        let all = self.operations.iter().map(|edit| (edit, "")).chain(undone);
        all.enumerate().map(|(i, (edit, mark))| format!("{}. {}{mark}", i + 1, edit.line(calibration))).collect()
    }

    /// Checks every edit that applies, and that the segments it names are known.
    ///
    /// # Errors
    /// [`EditError::Value`] or [`EditError::UnknownSegment`], for the first invalid edit.
    pub fn validate(&self, known: &dyn Fn(&str) -> bool) -> Result<(), EditError> {
        for (i, edit) in self.operations.iter().enumerate() {
            edit.validate()?;
            if let Some(name) = edit.segments.iter().find(|name| !known(name)) {
                return Err(EditError::UnknownSegment { edit: i + 1, name: name.clone() });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn renames_apply_to_edits_and_totals_add_up() {
        let edit =
            |names: &[&str], operation| Edit { segments: names.iter().map(|n| (*n).into()).collect(), operation };
        let mut stack = EditStack::default();
        let half = Operation::Opacity { factor: 0.5, show: false };
        let recolour = Operation::Recolour { rgb: [1.0, 0.5, 0.0], keep_shading: true };
        for operation in [recolour, half.clone(), Operation::Hide, half] {
            stack.push(edit(&["a", "b"], operation)).unwrap();
        }
        stack.push(edit(&["b"], Operation::Show)).unwrap();
        stack.undo();
        let total = CombinedEdit { rgb: Some([1.0, 0.5, 0.0]), opacity: 0.25, hidden: true };
        assert_eq!((stack.total("a"), stack.total("c")), (total, CombinedEdit::default()));
        assert!(stack.rename("b", "c") && !stack.rename("b", "d"));
        assert!(!stack.names("b") && stack.names("c"));
        assert_eq!(stack.undone[0].segments, ["c"]);
        stack.redo();
        assert_eq!(stack.total("c"), CombinedEdit { hidden: false, ..total });
        stack.push(edit(&["a"], Operation::Opacity { factor: 2.0, show: true })).unwrap();
        assert_eq!(stack.total("a"), CombinedEdit { opacity: 0.5, hidden: false, ..total });
    }
}
