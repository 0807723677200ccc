//! Evaluation of a run: metrics over a split, tables, pictures for reports.

pub mod results;
pub mod run;
pub mod sheet;
