//! Opacities by path length on a GPU: one unit per Gaussian, forward and backward. The formulas are those of `cpu`.

use super::ops::{PathBackwardOps, PathOps, PathTensors};
use super::{MIN_SQUARE, REACH, SMALL};
use crate::cube::prelude::*;
use crate::cube::vector::{Vec3, cross, dot, scaled, vec3_at};
use crate::cube::{UNITS, arg, cubes, empty_f32, is_finite, rows};
use crate::march::cube::opacity;
use crate::turn::NO_ROTATION;

/// A logit above which it is the optical depth.
const LARGE: f32 = 16.0;

/// The logarithm of the optical depth of a base logit, `ln(ln(1 + exp(logit)))`.
#[cube]
fn log_depth(logit: f32) -> f32 {
    let e = f32::exp(clamp(logit, comptime!(SMALL), comptime!(LARGE)));
    // ln(1 + e) from its series where e is small
    let series = e * (1.0f32 - e * (0.5f32 - e * (1.0f32 / 3.0f32 - e * 0.25f32)));
    let depth = select(e < 0.02f32, series, f32::ln(1.0f32 + e));
    let large = f32::ln(max(logit, 1.0f32));
    let within = select(logit > comptime!(LARGE), large, f32::ln(depth));
    // `clamp` and `max` drop NaN
    select(logit < comptime!(SMALL) || !is_finite(logit), logit, within)
}

/// The logit of the opacity of an optical depth, by its logarithm: `ln(exp(depth) - 1)`.
#[cube]
fn logit_of(log_depth: f32) -> f32 {
    let depth = f32::exp(max(log_depth, comptime!(SMALL)));
    let within = depth + f32::ln(opacity(depth));
    select(log_depth < comptime!(SMALL) || !is_finite(log_depth), log_depth, within)
}

/// `s0^2 / s^2` of an axis.
#[cube]
fn inverse_square(apart: f32) -> f32 {
    let within = f32::exp(2.0f32 * clamp(apart, comptime!(-REACH), comptime!(REACH)));
    select(is_finite(apart), within, apart)
}

/// A ray through the centre of a Gaussian.
#[derive(CubeType)]
struct CubeCentreRay {
    /// The inverse of the unit quaternion, and 1 over the former length, 0 for no rotation.
    w: f32,
    u: Vec3,
    inverse_length: f32,
    /// The unit direction in the world, and 1 over the distance.
    direction: Vec3,
    inverse_distance: f32,
    /// The direction along each axis of the Gaussian.
    local: Vec3,
    /// How much smaller than their mean each log scale is.
    apart: Vec3,
    /// `s0^2 / s^2` of each axis.
    inverse_squares: Vec3,
    /// `(s0 / L)^2`, and `p ln(L / s0)`; 1 and 0 at the eye itself, which has no direction.
    square: f32,
    gain: f32,
}

#[cube]
fn ray_of(
    means: &[f32],
    rotations: &[f32],
    log_scales: &[f32],
    i: usize,
    eye0: f32,
    eye1: f32,
    eye2: f32,
    exponent: f32,
) -> CubeCentreRay {
    let (qw, qx, qy, qz) = (rotations[4 * i], rotations[4 * i + 1], rotations[4 * i + 2], rotations[4 * i + 3]);
    let norm2 = qw * qw + qx * qx + qy * qy + qz * qz;
    let unturned = norm2 <= comptime!(NO_ROTATION);
    let inverse_length = select(unturned, 0.0f32, 1.0f32 / f32::sqrt(max(norm2, comptime!(NO_ROTATION))));
    let w = select(unturned, 1.0f32, qw * inverse_length);
    let u = Vec3 { x: -qx * inverse_length, y: -qy * inverse_length, z: -qz * inverse_length };
    let to = Vec3 { x: means[3 * i] - eye0, y: means[3 * i + 1] - eye1, z: means[3 * i + 2] - eye2 };
    let inverse_distance = 1.0f32 / f32::sqrt(max(dot(&to, &to), comptime!(MIN_SQUARE)));
    let d = scaled(&to, inverse_distance);
    let straight = w * w - u.x * u.x - u.y * u.y - u.z * u.z;
    let (along, across) = (2.0f32 * dot(&u, &d), cross(&u, &d));
    let l = Vec3 {
        x: straight * d.x + along * u.x + 2.0f32 * w * across.x,
        y: straight * d.y + along * u.y + 2.0f32 * w * across.y,
        z: straight * d.z + along * u.z + 2.0f32 * w * across.z,
    };
    let s = vec3_at(log_scales, 3 * i);
    let middle = (s.x + s.y + s.z) / 3.0f32;
    let apart = Vec3 { x: middle - s.x, y: middle - s.y, z: middle - s.z };
    let a = Vec3 { x: inverse_square(apart.x), y: inverse_square(apart.y), z: inverse_square(apart.z) };
    let square = l.x * l.x * a.x + l.y * l.y * a.y + l.z * l.z * a.z;
    let square = select(square == 0.0f32, 1.0f32, square);
    let gain = -0.5f32 * exponent * f32::ln(square);
    CubeCentreRay {
        w,
        u,
        inverse_length,
        direction: d,
        inverse_distance,
        local: l,
        apart,
        inverse_squares: a,
        square,
        gain,
    }
}

#[cube(launch)]
fn forward(
    means: &[f32],
    rotations: &[f32],
    log_scales: &[f32],
    logits: &[f32],
    out: &mut [f32],
    n: u32,
    eye0: f32,
    eye1: f32,
    eye2: f32,
    exponent: f32,
) {
    if ABSOLUTE_POS < n as usize {
        let i = ABSOLUTE_POS;
        let ray = ray_of(means, rotations, log_scales, i, eye0, eye1, eye2, exponent);
        out[i] = logit_of(log_depth(logits[i]) + ray.gain);
    }
}

#[cube(launch)]
fn backward(
    means: &[f32],
    rotations: &[f32],
    log_scales: &[f32],
    logits: &[f32],
    grad: &[f32],
    of_means: &mut [f32],
    of_rotations: &mut [f32],
    of_log_scales: &mut [f32],
    of_logits: &mut [f32],
    n: u32,
    eye0: f32,
    eye1: f32,
    eye2: f32,
    exponent: f32,
) {
    if ABSOLUTE_POS < n as usize {
        let i = ABSOLUTE_POS;
        let r = ray_of(means, rotations, log_scales, i, eye0, eye1, eye2, exponent);
        let base = log_depth(logits[i]);
        let seen = base + r.gain;
        // not drawn, or not finite
        let silent = grad[i] == 0.0f32 || !is_finite(logit_of(seen));

        let depth = f32::exp(clamp(seen, comptime!(SMALL), 80.0f32));
        let by_depth = grad[i] * select(seen < comptime!(SMALL), 1.0f32, depth / opacity(depth));
        let sigmoid = 1.0f32 / (1.0f32 + f32::exp(-max(logits[i], comptime!(SMALL))));
        let of_base = select(logits[i] < comptime!(SMALL), 1.0f32, sigmoid / f32::exp(base));
        let by_square = -0.5f32 * exponent * by_depth / r.square;
        let b = Vec3 {
            x: 2.0f32 * by_square * r.local.x * r.inverse_squares.x,
            y: 2.0f32 * by_square * r.local.y * r.inverse_squares.y,
            z: 2.0f32 * by_square * r.local.z * r.inverse_squares.z,
        };
        let ox = of_axis(r.apart.x, b.x * r.local.x);
        let oy = of_axis(r.apart.y, b.y * r.local.y);
        let oz = of_axis(r.apart.z, b.z * r.local.z);
        let mean = (ox + oy + oz) / 3.0f32;

        // back to the world, by the rotation itself
        let straight = r.w * r.w - r.u.x * r.u.x - r.u.y * r.u.y - r.u.z * r.u.z;
        let (ub, across) = (dot(&r.u, &b), cross(&r.u, &b));
        let vx = straight * b.x + 2.0f32 * (ub * r.u.x - r.w * across.x);
        let vy = straight * b.y + 2.0f32 * (ub * r.u.y - r.w * across.y);
        let vz = straight * b.z + 2.0f32 * (ub * r.u.z - r.w * across.z);
        let radial = vx * r.direction.x + vy * r.direction.y + vz * r.direction.z;

        // gradient of the quaternion, whose vector part has the other sign; along itself it has none
        let (ud, db, c) = (dot(&r.u, &r.direction), dot(&r.direction, &b), cross(&r.direction, &b));
        let gw = 2.0f32 * (r.w * db + r.u.x * c.x + r.u.y * c.y + r.u.z * c.z);
        let gx = -2.0f32 * (r.direction.x * ub + b.x * ud + r.w * c.x - r.u.x * db);
        let gy = -2.0f32 * (r.direction.y * ub + b.y * ud + r.w * c.y - r.u.y * db);
        let gz = -2.0f32 * (r.direction.z * ub + b.z * ud + r.w * c.z - r.u.z * db);
        let parallel = gw * r.w - gx * r.u.x - gy * r.u.y - gz * r.u.z;

        of_means[3 * i] = select(silent, 0.0f32, (vx - radial * r.direction.x) * r.inverse_distance);
        of_means[3 * i + 1] = select(silent, 0.0f32, (vy - radial * r.direction.y) * r.inverse_distance);
        of_means[3 * i + 2] = select(silent, 0.0f32, (vz - radial * r.direction.z) * r.inverse_distance);
        of_rotations[4 * i] = select(silent, 0.0f32, (gw - parallel * r.w) * r.inverse_length);
        of_rotations[4 * i + 1] = select(silent, 0.0f32, (gx + parallel * r.u.x) * r.inverse_length);
        of_rotations[4 * i + 2] = select(silent, 0.0f32, (gy + parallel * r.u.y) * r.inverse_length);
        of_rotations[4 * i + 3] = select(silent, 0.0f32, (gz + parallel * r.u.z) * r.inverse_length);
        of_log_scales[3 * i] = select(silent, 0.0f32, mean - ox);
        of_log_scales[3 * i + 1] = select(silent, 0.0f32, mean - oy);
        of_log_scales[3 * i + 2] = select(silent, 0.0f32, mean - oz);
        of_logits[i] = select(silent, 0.0f32, by_depth * of_base);
    }
}

/// The gradient of an axis that is `apart`, 0 beyond the bound.
#[cube]
fn of_axis(apart: f32, by: f32) -> f32 {
    select(f32::abs(apart) > comptime!(REACH), 0.0f32, by)
}

impl PathOps for CubeBackend {
    fn path_forward(inputs: PathTensors<Self>, eye: [f32; 3], exponent: f32) -> FloatTensor<Self> {
        let [means, rotations, log_scales, logits] = inputs.into_array().map(rows);
        let n = logits.meta.shape().num_elements();
        let out = empty_f32(&logits, [n]);
        let [eye0, eye1, eye2] = eye;
        forward::launch(
            &logits.client,
            cubes(n, UNITS),
            CubeDim::new_1d(UNITS),
            arg(&means),
            arg(&rotations),
            arg(&log_scales),
            arg(&logits),
            arg(&out),
            n as u32,
            eye0,
            eye1,
            eye2,
            exponent,
        );
        out
    }
}

impl PathBackwardOps for CubeBackend {
    fn path_backward(
        inputs: PathTensors<Self>,
        grad: FloatTensor<Self>,
        eye: [f32; 3],
        exponent: f32,
    ) -> PathTensors<Self> {
        let [means, rotations, log_scales, logits] = inputs.into_array().map(rows);
        let n = logits.meta.shape().num_elements();
        let out = [&means, &rotations, &log_scales, &logits].map(|t| empty_f32(t, t.meta.shape().clone()));
        let [eye0, eye1, eye2] = eye;
        backward::launch(
            &logits.client,
            cubes(n, UNITS),
            CubeDim::new_1d(UNITS),
            arg(&means),
            arg(&rotations),
            arg(&log_scales),
            arg(&logits),
            arg(&rows(grad)),
            arg(&out[0]),
            arg(&out[1]),
            arg(&out[2]),
            arg(&out[3]),
            n as u32,
            eye0,
            eye1,
            eye2,
            exponent,
        );
        PathTensors::from(out)
    }
}
