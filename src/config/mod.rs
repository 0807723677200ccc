//! Configuration of a run.

pub mod layers;
pub mod types;
