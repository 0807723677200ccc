//! The ordered edits with undo and redo. Nothing is applied here; files are read and written in `file`.

use super::error::EditError;
use super::operation::Edit;
use serde::{Deserialize, Serialize};

/// The version of `edits.json` that this program writes, and the newest it reads.
pub const VERSION: u32 = 1;

/// Edits in the order in which they apply, and those undone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EditStack {
    /// Version of the format, [`VERSION`].
    pub version: u32,
    /// The edits that apply, first to last.
    pub operations: Vec<Edit>,
    /// The edits undone, the last undone at the end.
    pub undone: Vec<Edit>,
}

impl Default for EditStack {
    fn default() -> Self {
        Self { version: VERSION, operations: Vec::new(), undone: Vec::new() }
    }
}

impl EditStack {
    /// Adds an edit at the end and forgets those undone.
    ///
    /// # Errors
    /// [`EditError::Value`]; the stack is then unchanged.
    pub fn push(&mut self, edit: Edit) -> Result<(), EditError> {
        edit.validate()?;
        self.operations.push(edit);
        self.undone.clear();
        Ok(())
    }

    /// Takes back the last edit and returns it; `None` if there is none.
    pub fn undo(&mut self) -> Option<&Edit> {
        self.undone.push(self.operations.pop()?);
        self.undone.last()
    }

    /// Applies the last edit undone again and returns it; `None` if there is none.
    pub fn redo(&mut self) -> Option<&Edit> {
        self.operations.push(self.undone.pop()?);
        self.operations.last()
    }

    /// A line for each edit, numbered from 1; those undone follow in the order in which redo brings them back.
    #[must_use]
    pub fn list(&self) -> Vec<String> {
        let undone = self.undone.iter().rev().map(|edit| (edit, " (undone)"));
        let all = self.operations.iter().map(|edit| (edit, "")).chain(undone);
        all.enumerate().map(|(i, (edit, mark))| format!("{}. {edit}{mark}", i + 1)).collect()
    }

    /// Checks every edit that applies, and that the segments it names are known.
    ///
    /// # Errors
    /// [`EditError::Value`] or [`EditError::UnknownSegment`], for the first that is wrong.
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
