//! The fast kernels over f32 arrays; Gaussians are independent.

use super::{LARGE, MIN_SQUARE, REACH, SMALL};
use crate::activation::sigmoid;
use crate::backend::zeros;
use crate::march::cpu::opacity;
use crate::turn::{NO_ROTATION, Vec3, dot, turn, turn_backward};
use rayon::prelude::*;

/// Gaussians per task.
const PIECE: usize = 1024;

/// The arrays of [`super::path_opacity`], row-major.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a> {
    /// `[N, 3]`
    pub means: &'a [f32],
    /// `[N, 4]`
    pub rotations: &'a [f32],
    /// `[N, 3]`
    pub log_scales: &'a [f32],
    /// `[N]`
    pub logits: &'a [f32],
    /// The eye, world units.
    pub eye: Vec3,
    /// The exponent.
    pub exponent: f32,
}

/// One array for each input, in the shape of the input.
#[derive(Clone, Debug)]
pub struct Gradients {
    /// `[N, 3]`
    pub means: Vec<f32>,
    /// `[N, 4]`
    pub rotations: Vec<f32>,
    /// `[N, 3]`
    pub log_scales: Vec<f32>,
    /// `[N]`
    pub logits: Vec<f32>,
}

/// A ray through the centre of a Gaussian.
struct Ray {
    /// The unit quaternion, and 1 over its former length, 0 for no rotation.
    w: f32,
    u: Vec3,
    inverse_length: f32,
    /// The unit direction in the world, and 1 over the distance.
    direction: Vec3,
    inverse_distance: f32,
    /// The direction along each axis of the Gaussian.
    local: Vec3,
    /// `s0^2 / s^2` of each axis, and whether it is a bound.
    inverse_squares: Vec3,
    bounded: [bool; 3],
    /// `(s0 / L)^2`.
    square: f32,
}

impl Ray {
    #[inline(always)]
    fn new(seen: &Seen<'_>, i: usize) -> Self {
        let triple = |v: &[f32], at: usize| [v[at], v[at + 1], v[at + 2]];
        let (mean, log_scales) = (triple(seen.means, 3 * i), triple(seen.log_scales, 3 * i));
        let (w, u) = (seen.rotations[4 * i], triple(seen.rotations, 4 * i + 1));
        let norm2 = w * w + dot(u, u);
        let (w, u, inverse_length) = if norm2 <= NO_ROTATION {
            (1.0, [0.0; 3], 0.0)
        } else {
            let inverse = 1.0 / norm2.sqrt();
            (w * inverse, u.map(|v| v * inverse), inverse)
        };
        let to: Vec3 = std::array::from_fn(|c| mean[c] - seen.eye[c]);
        let inverse_distance = 1.0 / dot(to, to).max(MIN_SQUARE).sqrt();
        let direction = to.map(|v| v * inverse_distance);
        let local = turn(w, u.map(|v| -v), direction);
        let middle = (log_scales[0] + log_scales[1] + log_scales[2]) / 3.0;
        let apart = log_scales.map(|s| middle - s);
        let inverse_squares = apart.map(|x| (2.0 * x.clamp(-REACH, REACH)).exp());
        let square = (0..3).map(|c| local[c] * local[c] * inverse_squares[c]).sum();
        let bounded = apart.map(|x| x.abs() > REACH);
        Self { w, u, inverse_length, direction, inverse_distance, local, inverse_squares, bounded, square }
    }

    /// `p ln(L / s0)`; 0 at the eye itself, which has no direction.
    #[inline(always)]
    fn gain(&self, exponent: f32) -> f32 {
        if self.square == 0.0 { 0.0 } else { -0.5 * exponent * self.square.ln() }
    }
}

/// The logarithm of the optical depth of a base logit, `ln(ln(1 + exp(logit)))`.
#[inline(always)]
fn log_depth(logit: f32) -> f32 {
    if logit < SMALL {
        logit
    } else if logit > LARGE {
        logit.ln()
    } else {
        logit.exp().ln_1p().ln()
    }
}

/// The logit of the opacity of an optical depth, by its logarithm: `ln(exp(depth) - 1)`.
#[inline(always)]
fn logit_of(log_depth: f32) -> f32 {
    if log_depth < SMALL {
        return log_depth;
    }
    let depth = log_depth.exp();
    if depth > LARGE { depth } else { depth.exp_m1().ln() }
}

/// Returns the logits `[N]` as the eye sees them.
#[must_use]
pub fn forward(seen: &Seen<'_>) -> Vec<f32> {
    let mut out = zeros(seen.logits.len());
    out.par_chunks_mut(PIECE).enumerate().for_each(|(piece, out)| {
        for (row, value) in out.iter_mut().enumerate() {
            let i = piece * PIECE + row;
            *value = logit_of(log_depth(seen.logits[i]) + Ray::new(seen, i).gain(seen.exponent));
        }
    });
    out
}

/// Returns the gradients of a loss whose gradient with respect to the result of [`forward`] is `grad` `[N]`. They are 0
/// where that is, and where the result is not finite.
#[must_use]
pub fn backward(seen: &Seen<'_>, grad: &[f32]) -> Gradients {
    let n = seen.logits.len();
    let mut out =
        Gradients { means: zeros(3 * n), rotations: zeros(4 * n), log_scales: zeros(3 * n), logits: zeros(n) };
    let pieces = (out.means.par_chunks_mut(3 * PIECE))
        .zip(out.rotations.par_chunks_mut(4 * PIECE))
        .zip(out.log_scales.par_chunks_mut(3 * PIECE))
        .zip(out.logits.par_chunks_mut(PIECE));
    pieces.enumerate().for_each(|(piece, (((means, rotations), log_scales), logits))| {
        for (row, of_logit) in logits.iter_mut().enumerate() {
            let i = piece * PIECE + row;
            // a Gaussian that is not drawn has no gradient
            if grad[i] == 0.0 {
                continue;
            }
            let Some(slopes) = slopes(seen, i, grad[i]) else { continue };
            means[3 * row..][..3].copy_from_slice(&slopes.mean);
            rotations[4 * row..][..4].copy_from_slice(&slopes.rotation);
            log_scales[3 * row..][..3].copy_from_slice(&slopes.log_scales);
            *of_logit = slopes.logit;
        }
    });
    out
}

/// Gradients with respect to the inputs of one Gaussian.
struct Slopes {
    mean: Vec3,
    rotation: [f32; 4],
    log_scales: Vec3,
    logit: f32,
}

#[inline(always)]
fn slopes(seen: &Seen<'_>, i: usize, grad: f32) -> Option<Slopes> {
    let ray = Ray::new(seen, i);
    let logit = seen.logits[i];
    let base = log_depth(logit);
    let log_depth_seen = base + ray.gain(seen.exponent);
    let depth = log_depth_seen.exp();
    // then `logit_of` is not finite either
    if !(log_depth_seen.is_finite() && depth.is_finite()) {
        return None;
    }
    // d logit / d log depth = depth / opacity
    let by_log_depth = grad * if log_depth_seen < SMALL { 1.0 } else { depth / opacity(depth) };
    let of_base = if logit < SMALL { 1.0 } else { sigmoid(logit) / base.exp() };
    let mut slopes = Slopes { mean: [0.0; 3], rotation: [0.0; 4], log_scales: [0.0; 3], logit: by_log_depth * of_base };
    if ray.square == 0.0 {
        return Some(slopes);
    }
    let by_square = -0.5 * seen.exponent * by_log_depth / ray.square;
    let by_local: Vec3 = std::array::from_fn(|c| 2.0 * by_square * ray.local[c] * ray.inverse_squares[c]);
    let of_axes: Vec3 = std::array::from_fn(|c| if ray.bounded[c] { 0.0 } else { by_local[c] * ray.local[c] });
    let middle = (of_axes[0] + of_axes[1] + of_axes[2]) / 3.0;
    slopes.log_scales = of_axes.map(|of| middle - of);
    // the part along a direction of unit length is taken out, as is that along the unit quaternion
    let by_direction = turn(ray.w, ray.u, by_local);
    let along = dot(by_direction, ray.direction);
    slopes.mean = std::array::from_fn(|c| (by_direction[c] - along * ray.direction[c]) * ray.inverse_distance);
    let (by_w, by_u) = turn_backward(ray.w, ray.u.map(|v| -v), ray.direction, by_local);
    let by_u = by_u.map(|v| -v);
    let along = by_w * ray.w + dot(by_u, ray.u);
    let part = |by: f32, of: f32| (by - along * of) * ray.inverse_length;
    slopes.rotation = [part(by_w, ray.w), part(by_u[0], ray.u[0]), part(by_u[1], ray.u[1]), part(by_u[2], ray.u[2])];
    Some(slopes)
}
