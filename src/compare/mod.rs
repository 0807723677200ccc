//! Comparison of runs: tables over seeds, differences to a baseline, curves, pictures.
//!
//! This module turns a [`ResultSet`] into text, numbers and pages. It knows run folders only by their files; runs are
//! made by `sweep`.

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

pub use results::{OutcomeState, PaperTable, ResultSet, VariantOutcome};
