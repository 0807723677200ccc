//! Training of a scene from images: stages, losses, densification, optimiser groups, checkpoints.
//!
//! A [`Training`] advances by one step at a time and knows nothing of folders or terminals; [`run`] drives one of any
//! method, with logs, evaluation, checkpoints and signals, and lets an [`observer`] watch. [`Trainer`]
//! is the training of Gaussians with a deformation field.

mod advice;
#[cfg(test)]
mod attribute_tests;
pub mod budget;
pub mod check;
pub mod checkpoint;
pub mod culling;
pub mod densify;
pub mod due;
mod ema;
mod error;
pub mod gather;
mod gaussian_training;
mod in_place;
pub mod init;
pub mod live;
pub mod losses;
pub mod observer;
mod open;
pub mod optimizer;
pub mod rate_schedule;
pub mod record;
mod report;
pub mod resume;
pub mod run;
pub mod schedule;
pub mod spatial;
pub mod target;
#[cfg(test)]
mod tests;
mod time_noise;
mod trainer;
mod training;
pub mod watch;

pub use advice::advice;
pub use check::{check as check_config, evaluation_background};
pub use error::TrainError;
pub use in_place::InPlace;
pub use open::{open_dataset, open_measured, open_trained, trained_times};
pub use report::{StepReport, StepTimes, timed};
pub use trainer::Trainer;
pub use training::{Saved, Training};
