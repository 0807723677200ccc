//! Logs of a run.

pub mod jsonl;
pub mod tensorboard;
