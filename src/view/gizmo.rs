//! Support for handles on the picture: edits that are shown while a handle is dragged, before anything is saved.

use crate::edit::Edit;
use schemars::JsonSchema;
use serde::Deserialize;

/// Maximum number of edits that a client may have shown at once.
const MAX_EDITS: usize = 8;
/// Maximum number of segments that each of them may name.
const MAX_SEGMENTS: usize = 1000;

/// Unsaved edits that are shown after those of the run.
#[derive(Clone, Debug, Deserialize, PartialEq, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Preview {
    /// Revision of the document that they belong to. They are not shown on any other, so that they are not applied
    /// twice once they are saved.
    pub base: u64,
    /// The edits, first to last.
    pub edits: Vec<Edit>,
}

impl Preview {
    /// Refuses what cannot be shown, whatever segments exist.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn check(&self) -> Result<(), String> {
        if self.edits.len() > MAX_EDITS || self.edits.iter().any(|e| e.segments.len() > MAX_SEGMENTS) {
            return Err(format!("preview: at most {MAX_EDITS} edits of {MAX_SEGMENTS} segments each"));
        }
        self.edits.iter().try_for_each(|edit| edit.validate().map_err(|e| format!("preview: {e}")))
    }

    /// Returns the edits to show on the document of `revision`.
    pub fn edits_on(preview: Option<&Self>, revision: u64) -> Vec<Edit> {
        preview.filter(|p| p.base == revision).map(|p| p.edits.clone()).unwrap_or_default()
    }
}
