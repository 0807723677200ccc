//! What a step did, and where its time went.

use std::time::Duration;

/// Where the time of a step went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepTimes {
    /// Choosing and compositing the view.
    pub data: Duration,
    /// Field and decoder, or another network, forward.
    pub deform: Duration,
    /// Splatting, or what else makes pixels of it, forward.
    pub splat: Duration,
    /// Loss, forward.
    pub loss: Duration,
    /// Everything backward.
    pub backward: Duration,
    /// Optimiser.
    pub adam: Duration,
    /// Statistics and densification.
    pub densify: Duration,
}

/// What a step did.
#[derive(Clone, Copy, Debug)]
pub struct StepReport {
    /// Global step, from 0.
    pub step: usize,
    /// The name of its stage: `warmup` or `joint`; `train` of a method without stages.
    pub stage: &'static str,
    /// The whole loss; on a device that runs ahead of the host, of the last step that was looked at.
    pub loss: f64,
    /// PSNR of that step's training view, decibels.
    pub psnr: f64,
    /// Gaussians after the step; 0 for a method without primitives.
    pub primitives: usize,
    /// Where the time went.
    pub times: StepTimes,
}
