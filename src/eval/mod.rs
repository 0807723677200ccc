//! Evaluation of a run: metrics over a split, tables, pictures for reports.

pub mod font;
pub mod plot;
pub mod run;
pub mod sheet;
