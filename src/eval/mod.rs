//! Evaluation of a run (metrics over a split, tables, pictures for reports) and of segments against known ones.

pub mod diagnosis;
pub mod distance;
pub mod regions;
pub mod results;
pub mod run;
pub mod segments;
pub mod sheet;
pub mod speed;
