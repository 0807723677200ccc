//! Logs of a run, and progress on the terminal.

pub mod jsonl;
pub mod progress;
pub mod tensorboard;
