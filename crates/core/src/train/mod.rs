//! Training of a scene from images: stages, losses, densification, optimiser groups, checkpoints.
//!
//! A [`Training`] advances by one step at a time and knows nothing of folders or terminals; [`run`] drives one of any
//! method, with logs, evaluation, checkpoints and signals, and lets an [`observer`] watch. [`Trainer`]
//! is the training of Gaussians with a deformation field.
//!
//! A step of the [`Trainer`]:
//!
//! ```text
//! densify:  what was due after the last step: plan rows on the host; gather attributes and moments by the same rows
//! schedule: stage, rates, SH degree, view          f(seed, step) alone
//! data:     u8 view over the background            -> target [H, W, 4]
//! deform:   means -> field(t) -> decoder           -> attributes at t        (warm-up: the canonical ones)
//! splat:    attributes + screen_offsets (zeros)    -> image, radii; a headlight shades the colours first
//! loss:     photometric + alpha, and every term whose weight is not 0: [DSSIM late] [TV in the joint stage] [...]
//! backward: burn's tape calls the ops' backward passes
//!           gradient of screen_offsets, radii, opacities -> densification statistics
//! adam:     each parameter by its name; the optimiser is the only owner, so it writes in place
//! ```
//!
//! Two stages: *warm-up* trains the canonical Gaussians alone, *joint* trains them with the field. Without a joint stage
//! (`stages.joint_steps = 0`) the result is a static scene. A non-finite loss or gradient stops the run and names the
//! tensor; on a GPU, a non-finite gradient does so at the next checkpoint at the latest.

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
pub use training::{SavedTraining, Training};
