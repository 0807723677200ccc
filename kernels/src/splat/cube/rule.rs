//! The compositing rule for one pixel, shared by drawing, its replay in the backward pass and the lists of
//! contributors, so that all three see the same weights.

use crate::cube::prelude::*;
use crate::splat::ALPHA_MAX;

/// Returns `ln` of alpha before it is clamped, at (dx, dy) from the Gaussian's centre.
#[cube]
pub(crate) fn log_alpha(dx: f32, dy: f32, qa: f32, qb: f32, qc: f32, ln_opacity: f32) -> f32 {
    (qa * dx + qb * dy) * dx + qc * dy * dy + ln_opacity
}

/// Returns alpha as it is blended.
#[cube]
pub(crate) fn clamped(alpha: f32) -> f32 {
    min(alpha, comptime!(ALPHA_MAX))
}
