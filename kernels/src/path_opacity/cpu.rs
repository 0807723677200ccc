//! The fast kernels over f32 arrays; Gaussians are independent. They go through in blocks, one array for each number, by
//! code without branches, so that it becomes vector instructions.

use super::{MIN_SQUARE, REACH, SMALL};
use crate::backend::zeros;
use crate::log_exp::{exp, ln};
use crate::splat::cpu::lanes::wide;
use crate::turn::{Float3, NO_ROTATION, dot, turn, turn_backward};
use rayon::prelude::*;

/// Gaussians per task.
const PIECE: usize = 1024;

/// Gaussians per block, as many as the widest vectors hold.
const BLOCK: usize = 16;

/// The logarithm of an optical depth that f32 still holds.
const LARGEST: f32 = 88.0;

/// The arrays of [`super::path_opacity`], row-major.
#[derive(Clone, Copy, Debug)]
pub struct PathOpacityArrays<'a> {
    /// `[N, 3]`
    pub means: &'a [f32],
    /// `[N, 4]`
    pub rotations: &'a [f32],
    /// `[N, 3]`
    pub log_scales: &'a [f32],
    /// `[N]`
    pub logits: &'a [f32],
    /// The eye, scene units.
    pub eye: Float3,
    /// The exponent.
    pub exponent: f32,
}

/// One Gaussian.
#[derive(Clone, Copy)]
struct PathGaussian {
    mean: Float3,
    w: f32,
    u: Float3,
    log_scales: Float3,
    logit: f32,
}

/// Gaussians side by side: `rows[k][i]` is number k of Gaussian i.
struct GaussianBlock {
    rows: [[f32; BLOCK]; 11],
}

impl GaussianBlock {
    /// Reads the `count` Gaussians from `first` on; the rest of the block is 0.
    #[inline(always)]
    fn read(seen: &PathOpacityArrays<'_>, first: usize, count: usize) -> Self {
        let mut rows = [[0.0; BLOCK]; 11];
        for lane in 0..count {
            let i = first + lane;
            for c in 0..3 {
                rows[c][lane] = seen.means[3 * i + c];
                rows[7 + c][lane] = seen.log_scales[3 * i + c];
            }
            for c in 0..4 {
                rows[3 + c][lane] = seen.rotations[4 * i + c];
            }
            rows[10][lane] = seen.logits[i];
        }
        Self { rows }
    }

    #[inline(always)]
    fn one(&self, lane: usize) -> PathGaussian {
        let at = |k: usize| self.rows[k][lane];
        let triple = |k: usize| [at(k), at(k + 1), at(k + 2)];
        PathGaussian { mean: triple(0), w: at(3), u: triple(4), log_scales: triple(7), logit: at(10) }
    }
}

/// A ray through the centre of a Gaussian.
struct CentreRay {
    /// The unit quaternion, and 1 over its former length, 0 for no rotation.
    w: f32,
    u: Float3,
    inverse_length: f32,
    /// The unit direction in the world, and 1 over the distance.
    direction: Float3,
    inverse_distance: f32,
    /// The direction along each axis of the Gaussian.
    local: Float3,
    /// `s0^2 / s^2` of each axis, and 1 if it is not bounded, else 0.
    inverse_squares: Float3,
    free: Float3,
    /// `(s0 / L)^2`; 1 at the eye itself, which has no direction.
    square: f32,
}

impl CentreRay {
    #[inline(always)]
    fn new(one: &PathGaussian, eye: Float3) -> Self {
        let norm2 = one.w * one.w + dot(one.u, one.u);
        let still = norm2 <= NO_ROTATION;
        let inverse_length = if still { 0.0 } else { 1.0 / norm2.sqrt() };
        let w = if still { 1.0 } else { one.w * inverse_length };
        let u = one.u.map(|v| v * inverse_length);
        let to: Float3 = std::array::from_fn(|c| one.mean[c] - eye[c]);
        let length2 = dot(to, to);
        let inverse_distance = 1.0 / if length2 < MIN_SQUARE { MIN_SQUARE } else { length2 }.sqrt();
        let direction = to.map(|v| v * inverse_distance);
        let local = turn(w, u.map(|v| -v), direction);
        let [a, b, c] = one.log_scales;
        let middle = (a + b + c) / 3.0;
        let apart = one.log_scales.map(|s| middle - s);
        let inverse_squares = apart.map(|x| exp(2.0 * x.clamp(-REACH, REACH)));
        let free = apart.map(|x| if x.abs() > REACH { 0.0 } else { 1.0 });
        let part = |c: usize| local[c] * local[c] * inverse_squares[c];
        let square = part(0) + part(1) + part(2);
        let square = if square == 0.0 { 1.0 } else { square };
        Self { w, u, inverse_length, direction, inverse_distance, local, inverse_squares, free, square }
    }

    /// `p ln(L / s0)`.
    #[inline(always)]
    fn gain(&self, exponent: f32) -> f32 {
        -0.5 * exponent * ln(self.square)
    }
}

/// The optical depth of a base logit, and its logarithm, `ln(ln(1 + exp(logit)))`.
#[inline(always)]
fn depth_of(logit: f32) -> (f32, f32) {
    // exp(-|x|), so that nothing overflows
    let small = exp(-logit.abs());
    let one_more = 1.0 + small;
    // ln(1 + small), by Kahan's correction of what `1.0 + small` rounds away
    let rest = one_more - 1.0;
    let log = if rest == 0.0 { small } else { ln(one_more) * (small / if rest == 0.0 { 1.0 } else { rest }) };
    let depth = if logit > 0.0 { logit + log } else { log };
    let log_depth = ln(depth);
    (depth, if logit < SMALL { logit } else { log_depth })
}

/// The logit of the opacity of an optical depth, by the depth and its logarithm: `ln(exp(depth) - 1)`.
#[inline(always)]
fn logit_of(depth: f32, log_depth: f32) -> f32 {
    let square = depth * depth;
    // ln((exp(d) - 1) / d) = d / 2 + ln(sinh(d / 2) / (d / 2)), as a series
    let series = square * (1.0 / 24.0 + square * (-1.0 / 2_880.0 + square * (1.0 / 181_440.0)));
    let thin = log_depth + (0.5 * depth + series);
    let thick = depth + ln(1.0 - exp(if depth < 1.0 { -1.0 } else { -depth }));
    let logit = if depth < 1.0 { thin } else { thick };
    if log_depth < SMALL { log_depth } else { logit }
}

/// `depth / (1 - exp(-depth))`.
#[inline(always)]
fn depth_by_opacity(depth: f32) -> f32 {
    let square = depth * depth;
    let series = square * (1.0 / 12.0 + square * (-1.0 / 720.0 + square * (1.0 / 30_240.0)));
    let thick = depth / (1.0 - exp(if depth < 1.0 { -1.0 } else { -depth }));
    if depth < 1.0 { 1.0 + (0.5 * depth + series) } else { thick }
}

/// Returns the logits `[N]` as the eye sees them.
pub fn forward(seen: &PathOpacityArrays<'_>) -> Vec<f32> {
    let mut out = zeros(seen.logits.len());
    out.par_chunks_mut(PIECE).enumerate().for_each(|(piece, out)| {
        wide!(for (block, out) in out.chunks_mut(BLOCK).enumerate() {
            let read = GaussianBlock::read(seen, piece * PIECE + block * BLOCK, out.len());
            let mut values = [0.0; BLOCK];
            for (lane, value) in values.iter_mut().enumerate() {
                *value = one_forward(&read.one(lane), seen);
            }
            out.copy_from_slice(&values[..out.len()]);
        });
    });
    out
}

#[inline(always)]
fn one_forward(one: &PathGaussian, seen: &PathOpacityArrays<'_>) -> f32 {
    let log_depth = depth_of(one.logit).1 + CentreRay::new(one, seen.eye).gain(seen.exponent);
    let logit = logit_of(exp(log_depth), log_depth);
    // beyond what f32 holds: infinity, or NaN
    if log_depth < LARGEST { logit } else { log_depth * f32::INFINITY }
}

/// Returns the gradients of a loss whose gradient with respect to the result of [`forward`] is `grad` `[N]`: those with
/// respect to means `[N, 3]`, rotations `[N, 4]`, log-scales `[N, 3]` and logits `[N]`. They are 0 where `grad` is, and
/// where the result is not finite.
pub fn backward(seen: &PathOpacityArrays<'_>, grad: &[f32]) -> [Vec<f32>; 4] {
    let n = seen.logits.len();
    let mut out = [3, 4, 3, 1].map(|width| zeros(width * n));
    let [means, rotations, log_scales, logits] = &mut out;
    let pieces = (means.par_chunks_mut(3 * PIECE))
        .zip(rotations.par_chunks_mut(4 * PIECE))
        .zip(log_scales.par_chunks_mut(3 * PIECE))
        .zip(logits.par_chunks_mut(PIECE));
    pieces.enumerate().for_each(|(piece, (((means, rotations), log_scales), logits))| {
        wide!(for start in (0..logits.len()).step_by(BLOCK) {
            let (first, count) = (piece * PIECE + start, BLOCK.min(logits.len() - start));
            let read = GaussianBlock::read(seen, first, count);
            let mut by = [0.0; BLOCK];
            by[..count].copy_from_slice(&grad[first..first + count]);
            let mut slopes = [[0.0; BLOCK]; 11];
            for lane in 0..BLOCK {
                for (row, value) in slopes.iter_mut().zip(one_backward(&read.one(lane), seen, by[lane])) {
                    row[lane] = value;
                }
            }
            for lane in 0..count {
                let row = start + lane;
                for c in 0..3 {
                    means[3 * row + c] = slopes[c][lane];
                    log_scales[3 * row + c] = slopes[7 + c][lane];
                }
                for c in 0..4 {
                    rotations[4 * row + c] = slopes[3 + c][lane];
                }
                logits[row] = slopes[10][lane];
            }
        });
    });
    out
}

/// Gradients with respect to the mean, rotation, log scales and logit of one Gaussian.
#[inline(always)]
fn one_backward(one: &PathGaussian, seen: &PathOpacityArrays<'_>, grad: f32) -> [f32; 11] {
    let ray = CentreRay::new(one, seen.eye);
    let (base, log_base) = depth_of(one.logit);
    let log_depth = log_base + ray.gain(seen.exponent);
    let depth = exp(log_depth);
    // a Gaussian that is not drawn has no gradient, nor has one whose logit is not finite; NaN is not within
    let counts = grad != 0.0 && log_depth > -f32::MAX && log_depth < LARGEST;
    // d logit / d log depth = depth / opacity
    let by_log_depth = grad * if log_depth < SMALL { 1.0 } else { depth_by_opacity(depth) };
    // the sigmoid over the depth
    let of_base = if one.logit < SMALL { 1.0 } else { 1.0 / ((1.0 + exp(-one.logit)) * base) };
    let by_square = -0.5 * seen.exponent * by_log_depth / ray.square;
    let by_local: Float3 = std::array::from_fn(|c| 2.0 * by_square * ray.local[c] * ray.inverse_squares[c]);
    let of_axes: Float3 = std::array::from_fn(|c| ray.free[c] * by_local[c] * ray.local[c]);
    let middle = (of_axes[0] + of_axes[1] + of_axes[2]) / 3.0;
    // the part along a direction of unit length is taken out, as is that along the unit quaternion
    let by_direction = turn(ray.w, ray.u, by_local);
    let along = dot(by_direction, ray.direction);
    let mean = |c: usize| (by_direction[c] - along * ray.direction[c]) * ray.inverse_distance;
    let (by_w, by_u) = turn_backward(ray.w, ray.u.map(|v| -v), ray.direction, by_local);
    let by_u = by_u.map(|v| -v);
    let along = by_w * ray.w + dot(by_u, ray.u);
    let part = |by: f32, of: f32| (by - along * of) * ray.inverse_length;
    let slopes = [
        mean(0),
        mean(1),
        mean(2),
        part(by_w, ray.w),
        part(by_u[0], ray.u[0]),
        part(by_u[1], ray.u[1]),
        part(by_u[2], ray.u[2]),
        middle - of_axes[0],
        middle - of_axes[1],
        middle - of_axes[2],
        by_log_depth * of_base,
    ];
    slopes.map(|slope| if counts { slope } else { 0.0 })
}
