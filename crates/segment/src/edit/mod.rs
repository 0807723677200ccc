//! Edits of segments: an ordered stack of pure data with undo, and its application to the Gaussians of one time.
//!
//! The stack refers to segments only by name and never holds Gaussians, so that an edit made at one time applies at
//! every time: each time's Gaussians are edited afresh from the trained ones. Nothing here draws, tracks or chooses
//! segments.

mod apply;
mod error;
mod file;
mod operation;
mod sh;
mod stack;
mod state;
#[cfg(test)]
mod tests;

pub use apply::{apply, centre};
pub use error::EditError;
pub use operation::{Edit, Operation};
pub use sh::ShRotation;
pub use stack::{CombinedEdit, EditStack};
pub use state::HIDDEN_LOGIT;
