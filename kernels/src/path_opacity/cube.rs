//! Opacities by path length on a GPU: one unit per Gaussian, forward and backward. The formulas are those of `cpu`.

use super::ops::{PathBackwardOps, PathOps, PathTensors};
use super::{MIN_SQUARE, REACH, SMALL};
use crate::cube::{UNITS, arg, cubes, empty_f32, is_finite, rows};
use crate::march::cube::opacity;
use crate::turn::NO_ROTATION;
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl;
use burn_cubecl::cubecl::prelude::*;

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
struct Ray {
    /// The inverse of the unit quaternion, and 1 over the former length, 0 for no rotation.
    w: f32,
    ux: f32,
    uy: f32,
    uz: f32,
    inverse_length: f32,
    /// The unit direction in the world, and 1 over the distance.
    dx: f32,
    dy: f32,
    dz: f32,
    inverse_distance: f32,
    /// The direction along each axis of the Gaussian.
    lx: f32,
    ly: f32,
    lz: f32,
    /// How much smaller than their mean each log scale is.
    apart_x: f32,
    apart_y: f32,
    apart_z: f32,
    /// `s0^2 / s^2` of each axis.
    ax: f32,
    ay: f32,
    az: f32,
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
) -> Ray {
    let (qw, qx, qy, qz) = (rotations[4 * i], rotations[4 * i + 1], rotations[4 * i + 2], rotations[4 * i + 3]);
    let norm2 = qw * qw + qx * qx + qy * qy + qz * qz;
    let unturned = norm2 <= comptime!(NO_ROTATION);
    let inverse_length = select(unturned, 0.0f32, 1.0f32 / f32::sqrt(max(norm2, comptime!(NO_ROTATION))));
    let w = select(unturned, 1.0f32, qw * inverse_length);
    let ux = -qx * inverse_length;
    let uy = -qy * inverse_length;
    let uz = -qz * inverse_length;
    let tx = means[3 * i] - eye0;
    let ty = means[3 * i + 1] - eye1;
    let tz = means[3 * i + 2] - eye2;
    let inverse_distance = 1.0f32 / f32::sqrt(max(tx * tx + ty * ty + tz * tz, comptime!(MIN_SQUARE)));
    let dx = tx * inverse_distance;
    let dy = ty * inverse_distance;
    let dz = tz * inverse_distance;
    let straight = w * w - ux * ux - uy * uy - uz * uz;
    let along = 2.0f32 * (ux * dx + uy * dy + uz * dz);
    let lx = straight * dx + along * ux + 2.0f32 * w * (uy * dz - uz * dy);
    let ly = straight * dy + along * uy + 2.0f32 * w * (uz * dx - ux * dz);
    let lz = straight * dz + along * uz + 2.0f32 * w * (ux * dy - uy * dx);
    let (sx, sy, sz) = (log_scales[3 * i], log_scales[3 * i + 1], log_scales[3 * i + 2]);
    let middle = (sx + sy + sz) / 3.0f32;
    let apart_x = middle - sx;
    let apart_y = middle - sy;
    let apart_z = middle - sz;
    let ax = inverse_square(apart_x);
    let ay = inverse_square(apart_y);
    let az = inverse_square(apart_z);
    let square = lx * lx * ax + ly * ly * ay + lz * lz * az;
    let square = select(square == 0.0f32, 1.0f32, square);
    let gain = -0.5f32 * exponent * f32::ln(square);
    Ray {
        w,
        ux,
        uy,
        uz,
        inverse_length,
        dx,
        dy,
        dz,
        inverse_distance,
        lx,
        ly,
        lz,
        apart_x,
        apart_y,
        apart_z,
        ax,
        ay,
        az,
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
        let bx = 2.0f32 * by_square * r.lx * r.ax;
        let by = 2.0f32 * by_square * r.ly * r.ay;
        let bz = 2.0f32 * by_square * r.lz * r.az;
        let ox = of_axis(r.apart_x, bx * r.lx);
        let oy = of_axis(r.apart_y, by * r.ly);
        let oz = of_axis(r.apart_z, bz * r.lz);
        let mean = (ox + oy + oz) / 3.0f32;

        // back to the world, by the rotation itself
        let straight = r.w * r.w - r.ux * r.ux - r.uy * r.uy - r.uz * r.uz;
        let ub = r.ux * bx + r.uy * by + r.uz * bz;
        let vx = straight * bx + 2.0f32 * (ub * r.ux - r.w * (r.uy * bz - r.uz * by));
        let vy = straight * by + 2.0f32 * (ub * r.uy - r.w * (r.uz * bx - r.ux * bz));
        let vz = straight * bz + 2.0f32 * (ub * r.uz - r.w * (r.ux * by - r.uy * bx));
        let radial = vx * r.dx + vy * r.dy + vz * r.dz;

        // gradient of the quaternion, whose vector part has the other sign; along itself it has none
        let ud = r.ux * r.dx + r.uy * r.dy + r.uz * r.dz;
        let db = r.dx * bx + r.dy * by + r.dz * bz;
        let cx = r.dy * bz - r.dz * by;
        let cy = r.dz * bx - r.dx * bz;
        let cz = r.dx * by - r.dy * bx;
        let gw = 2.0f32 * (r.w * db + r.ux * cx + r.uy * cy + r.uz * cz);
        let gx = -2.0f32 * (r.dx * ub + bx * ud + r.w * cx - r.ux * db);
        let gy = -2.0f32 * (r.dy * ub + by * ud + r.w * cy - r.uy * db);
        let gz = -2.0f32 * (r.dz * ub + bz * ud + r.w * cz - r.uz * db);
        let parallel = gw * r.w - gx * r.ux - gy * r.uy - gz * r.uz;

        of_means[3 * i] = select(silent, 0.0f32, (vx - radial * r.dx) * r.inverse_distance);
        of_means[3 * i + 1] = select(silent, 0.0f32, (vy - radial * r.dy) * r.inverse_distance);
        of_means[3 * i + 2] = select(silent, 0.0f32, (vz - radial * r.dz) * r.inverse_distance);
        of_rotations[4 * i] = select(silent, 0.0f32, (gw - parallel * r.w) * r.inverse_length);
        of_rotations[4 * i + 1] = select(silent, 0.0f32, (gx + parallel * r.ux) * r.inverse_length);
        of_rotations[4 * i + 2] = select(silent, 0.0f32, (gy + parallel * r.uy) * r.inverse_length);
        of_rotations[4 * i + 3] = select(silent, 0.0f32, (gz + parallel * r.uz) * r.inverse_length);
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
