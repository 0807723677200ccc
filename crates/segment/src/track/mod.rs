//! Tracking of segments through time: what a segment is like at each time, and when its parts appear, vanish, split and
//! merge. How segments are found is not decided here (see `segment`).

pub mod eigen;
pub(crate) mod event;
pub mod events;
pub mod follow;
pub mod motion;
pub(crate) mod overlap;
pub mod report;
pub mod statistics;
pub mod tables;
pub mod velocity;
pub mod volume;
