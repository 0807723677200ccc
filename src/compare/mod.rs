//! Runs side by side: tables over seeds, differences to a base, curves, pictures.
//!
//! Here a [`ResultSet`] becomes text, numbers and pages. How runs come about is `sweep`'s; this folder knows run folders
//! by their files alone.

pub mod curves;
pub mod html;
pub mod metric;
mod places;
pub mod results;
pub mod runs;
pub mod sheet;
pub mod stats;
pub mod table;
pub mod text;
pub mod write;

pub use results::{Outcome, OutcomeState, PaperTable, ResultSet};
