//! Training: images in, a scene out. Stages, losses, densification, optimiser groups, checkpoints.
//!
//! [`Trainer`] takes one step at a time and knows nothing of folders or terminals; [`run`] drives it
//! with logs, evaluation, checkpoints and signals, and lets an [`observer`] look on.

#[cfg(test)]
mod appearance_tests;
mod budget;
mod check;
pub mod checkpoint;
pub mod culling;
pub mod densify;
pub mod due;
pub mod gather;
pub mod init;
pub mod live;
mod logs;
pub mod loss_term;
pub mod losses;
pub mod observer;
mod open;
pub mod optimizer;
pub mod rate_schedule;
pub mod resume;
pub mod run;
pub mod schedule;
pub mod spatial;
mod target;
#[cfg(test)]
mod tests;
mod trainer;

pub use check::{check as check_config, evaluation_background};
pub use open::{open_dataset, open_measured, open_trained, trained_times};
pub use trainer::{StepReport, TrainError, Trainer};
