//! Outcome and timings of a step.

use std::time::Duration;

/// Times of the parts of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepTimes {
    /// Choosing and compositing the view.
    pub data: Duration,
    /// Forward pass of field and decoder, or of another network.
    pub deform: Duration,
    /// Forward pass of splatting, or of another renderer.
    pub splat: Duration,
    /// Forward pass of the loss.
    pub loss: Duration,
    /// The whole backward pass.
    pub backward: Duration,
    /// Optimiser.
    pub adam: Duration,
    /// Statistics and densification.
    pub densify: Duration,
}

/// Outcome of a step.
#[derive(Clone, Copy, Debug)]
pub struct StepReport {
    /// Global step, from 0.
    pub step: usize,
    /// Name of its stage: `warmup` or `joint`; `train` for a method without stages.
    pub stage: &'static str,
    /// Total loss; on a device that runs ahead of the host, that of the last step that was read.
    pub loss: f64,
    /// PSNR of that step's training view, decibels.
    pub psnr: f64,
    /// Gaussians after the step; 0 for a method without primitives.
    pub primitives: usize,
    /// Times of its parts.
    pub times: StepTimes,
}
