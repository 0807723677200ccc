//! The field on a GPU. Forward: one unit per feature of a point. Backward: 32 units per point, each with every 32nd
//! feature; gradients of points are reduced in shared memory, those of time rows within a cube and then over cubes in
//! order; those of planes and lines are scattered with float atomics, so that their last bits vary from run to run.
#![allow(clippy::collapsible_if)] // the inner condition must not be read unless the outer one holds

mod sample;

use super::ops::{FieldBackwardOps, FieldOps, FieldTensors};
use super::shape::FieldShape;
use crate::cube::atomic::{AddF32, Exchange, Native};
use crate::cube::prelude::*;
use crate::cube::{UNITS, Words, arg, cubes, empty_f32, launched, path, rows};
use burn::tensor::DType;
use burn_cubecl::ops::numeric::zeros_client;
use sample::{CubeLineNodes, CubePlaneNodes, is_somewhere, read};

/// Points that a unit of the backward pass visits in turn.
const VISITS: u32 = 16;
/// Units per point; `SIDE` is the number of points that a cube processes at a time.
const LANES: u32 = 32;
const SIDE: u32 = UNITS / LANES;

/// Words per level: nodes along x, y, z; offsets of its planes xy, xz, yz; offsets of its lines x, y, z.
const LEVEL: usize = 9;

fn level_words(shape: &FieldShape) -> Vec<u32> {
    let (planes, lines) = (shape.plane_spans(), shape.line_spans());
    let mut words = Vec::with_capacity(LEVEL * shape.levels.len());
    for (i, level) in shape.levels.iter().enumerate() {
        words.extend(level.resolution.map(|n| n as u32));
        words.extend((0..3).map(|k| planes[3 * i + k].offset as u32));
        words.extend((0..3).map(|k| lines[3 * i + k].offset as u32));
    }
    words
}

/// Returns the time knots around `time`: lower, upper, fraction.
fn time_tap(shape: &FieldShape, time: f32) -> (u32, u32, f32) {
    let last = (shape.time_knots - 1) as f32;
    let grid = (time * last).max(0.0).min(last);
    let low = (grid as usize).min(shape.time_knots.saturating_sub(2));
    (low as u32, (low + 1).min(shape.time_knots - 1) as u32, grid - low as f32)
}

/// Computes the time row of every level, `[levels * R]`.
#[cube(launch)]
fn time_row(times: &[f32], row: &mut [f32], knots: u32, channels: u32, features: u32, lo: u32, hi: u32, frac: f32) {
    if ABSOLUTE_POS < features as usize {
        let f = ABSOLUTE_POS as u32;
        let base = (f / channels) * knots * channels + f % channels;
        let first = times[(base + lo * channels) as usize];
        row[f as usize] = first + frac * (times[(base + hi * channels) as usize] - first);
    }
}

#[cube(launch)]
fn forward(
    planes: &[f32],
    lines: &[f32],
    row: &[f32],
    points: &[f32],
    levels: &[u32],
    out: &mut [f32],
    features: u32,
    channels: u32,
    total: u32,
) {
    if ABSOLUTE_POS < total as usize {
        let i = ABSOLUTE_POS / features as usize;
        let f = ABSOLUTE_POS % features as usize;
        let mut value = 0.0f32;
        if is_somewhere(points, i) {
            let s = read(planes, lines, points, levels, i, f, channels as usize);
            value = s.sum() * row[f];
        }
        out[ABSOLUTE_POS] = value;
    }
}

/// Adds `value` times the bilinear weights to the four nodes.
#[cube]
fn scatter<A: AddF32>(out: &mut [Atomic<A::Storage>], nodes: &CubePlaneNodes, fast: f32, slow: f32, value: f32) {
    A::add(&out[nodes.at00], value * (1.0f32 - slow) * (1.0f32 - fast));
    A::add(&out[nodes.at01], value * (1.0f32 - slow) * fast);
    A::add(&out[nodes.at10], value * slow * (1.0f32 - fast));
    A::add(&out[nodes.at11], value * slow * fast);
}

/// Adds `value` times the linear weights to the two nodes.
#[cube]
fn spread<A: AddF32>(out: &mut [Atomic<A::Storage>], nodes: &CubeLineNodes, frac: f32, value: f32) {
    A::add(&out[nodes.lo], value * (1.0f32 - frac));
    A::add(&out[nodes.hi], value * frac);
}

#[cube(launch)]
fn backward<A: AddF32>(
    planes: &[f32],
    lines: &[f32],
    row: &[f32],
    points: &[f32],
    grad: &[f32],
    levels: &[u32],
    out_planes: &mut [Atomic<A::Storage>],
    out_lines: &mut [Atomic<A::Storage>],
    out_points: &mut [f32],
    time_parts: &mut [f32],
    n: u32,
    channels: u32,
    #[comptime] features: u32,
) {
    let mut shared = Shared::<[f32]>::new_slice(768usize);
    let lane = UNIT_POS % comptime!(LANES);
    let side = UNIT_POS / comptime!(LANES);
    let slots = comptime!(features.div_ceil(LANES));
    let mut time_sums = Array::<f32>::new(comptime!(slots as usize));
    #[unroll]
    for slot in 0..slots {
        time_sums[slot as usize] = 0.0f32;
    }
    for visit in 0..comptime!(VISITS) {
        let i = ((CUBE_POS as u32 * comptime!(VISITS) + visit) * comptime!(SIDE) + side) as usize;
        let mut gx = 0.0f32;
        let mut gy = 0.0f32;
        let mut gz = 0.0f32;
        if i < n as usize {
            if is_somewhere(points, i) {
                #[unroll]
                for slot in 0..slots {
                    let f = (slot * comptime!(LANES) + lane) as usize;
                    if f < comptime!(features as usize) {
                        let g = grad[i * comptime!(features as usize) + f];
                        // Gaussians seen by no pixel have a gradient of zero
                        if g != 0.0f32 {
                            let s = read(planes, lines, points, levels, i, f, channels as usize);
                            time_sums[slot as usize] += g * s.sum();
                            let space = g * row[f];
                            let (g_xy, g_xz, g_yz) = (space * s.z.value, space * s.y.value, space * s.x.value);
                            let (g_x, g_y, g_z) = (space * s.yz.value, space * s.xz.value, space * s.xy.value);
                            gx += (g_xy * s.xy.fast + g_xz * s.xz.fast + g_x * s.x.slope) * s.tx.slope;
                            gy += (g_xy * s.xy.slow + g_yz * s.yz.fast + g_y * s.y.slope) * s.ty.slope;
                            gz += (g_xz * s.xz.slow + g_yz * s.yz.slow + g_z * s.z.slope) * s.tz.slope;
                            scatter::<A>(out_planes, &s.xy, s.tx.frac, s.ty.frac, g_xy);
                            scatter::<A>(out_planes, &s.xz, s.tx.frac, s.tz.frac, g_xz);
                            scatter::<A>(out_planes, &s.yz, s.ty.frac, s.tz.frac, g_yz);
                            spread::<A>(out_lines, &s.x, s.tx.frac, g_x);
                            spread::<A>(out_lines, &s.y, s.ty.frac, g_y);
                            spread::<A>(out_lines, &s.z, s.tz.frac, g_z);
                        }
                    }
                }
            }
        }
        // reduce the 32 sums of each point
        let at = (UNIT_POS * 3u32) as usize;
        shared[at] = gx;
        shared[at + 1] = gy;
        shared[at + 2] = gz;
        sync_cube();
        let mut half = 16u32;
        while half > 0u32 {
            if lane < half {
                let other = at + (half * 3u32) as usize;
                #[unroll]
                for k in 0..3usize {
                    let more = shared[other + k];
                    shared[at + k] += more;
                }
            }
            sync_cube();
            half /= 2u32;
        }
        if lane < 3u32 && i < n as usize {
            out_points[3 * i + lane as usize] = shared[(side * comptime!(LANES) * 3u32 + lane) as usize];
        }
        sync_cube();
    }
    #[unroll]
    for slot in 0..slots {
        shared[UNIT_POS as usize] = time_sums[slot as usize];
        sync_cube();
        let f = slot * comptime!(LANES) + lane;
        if side == 0u32 && f < comptime!(features) {
            let mut sum = 0.0f32;
            for other in 0..comptime!(SIDE) {
                sum += shared[(other * comptime!(LANES) + lane) as usize];
            }
            time_parts[CUBE_POS * comptime!(features as usize) + f as usize] = sum;
        }
        sync_cube();
    }
}

/// Adds the cubes' sums in a fixed order and distributes them over the two knots; one cube per feature, and the rest of
/// `out` stays zero.
#[cube(launch)]
fn sum_times(
    parts: &[f32],
    out: &mut [f32],
    count: u32,
    knots: u32,
    channels: u32,
    features: u32,
    lo: u32,
    hi: u32,
    frac: f32,
) {
    let f = CUBE_POS as u32;
    let mut sum = 0.0f32;
    if f < features {
        let mut k = UNIT_POS;
        while k < count {
            sum += parts[(k * features + f) as usize];
            k += 256u32;
        }
    }
    let total = crate::cube::reduce::over_cube(sum);
    if UNIT_POS == 0u32 && f < features {
        let base = (f / channels) * knots * channels + f % channels;
        out[(base + lo * channels) as usize] = total * (1.0f32 - frac);
        if hi != lo {
            out[(base + hi * channels) as usize] = total * frac;
        }
    }
}

fn row_at(client: &Client, times: &CubeTensor, shape: &FieldShape, time: f32) -> Words {
    let features = shape.features_len();
    let row = Words::empty(client, features);
    let (lo, hi, frac) = time_tap(shape, time);
    time_row::launch(
        client,
        cubes(features, UNITS),
        CubeDim::new_1d(UNITS),
        arg(times),
        row.arg(),
        shape.time_knots as u32,
        shape.channels as u32,
        features as u32,
        lo,
        hi,
        frac,
    );
    row
}

fn zeros(like: &CubeTensor) -> CubeTensor {
    zeros_client(like.client.clone(), like.device.clone(), like.meta.shape().clone(), DType::F32)
}

impl FieldOps for CubeBackend {
    fn field_forward(inputs: FieldTensors<Self>, shape: FieldShape, time: f32) -> FloatTensor<Self> {
        let [planes, lines, times, points] = inputs.into_array().map(rows);
        let client = points.client.clone();
        let n = points.meta.shape()[0];
        let features = shape.features_len();
        let row = row_at(&client, &times, &shape, time);
        let out = empty_f32(&points, [n, features]);
        forward::launch(
            &client,
            cubes(n * features, UNITS),
            CubeDim::new_1d(UNITS),
            arg(&planes),
            arg(&lines),
            row.arg(),
            arg(&points),
            Words::u32s(&client, &level_words(&shape)).arg(),
            arg(&out),
            features as u32,
            shape.channels as u32,
            (n * features) as u32,
        );
        out
    }
}

impl FieldBackwardOps for CubeBackend {
    fn field_backward(
        inputs: FieldTensors<Self>,
        grad: FloatTensor<Self>,
        shape: FieldShape,
        time: f32,
    ) -> FieldTensors<Self> {
        let [planes, lines, times, points] = inputs.into_array().map(rows);
        let grad = rows(grad);
        let client = points.client.clone();
        let n = points.meta.shape()[0];
        let features = shape.features_len();
        let row = row_at(&client, &times, &shape, time);
        let out = FieldTensors {
            planes: zeros(&planes),
            lines: zeros(&lines),
            times: zeros(&times),
            points: empty_f32(&points, [n, 3]),
        };
        let count = n.div_ceil((VISITS * SIDE) as usize).max(1);
        let launched = launched(&cubes(count, 1));
        let parts = Words::empty(&client, launched * features);
        let levels = Words::u32s(&client, &level_words(&shape));
        macro_rules! go {
            ($add:ty) => {
                backward::launch::<$add>(
                    &client,
                    cubes(count, 1),
                    CubeDim::new_1d(UNITS),
                    arg(&planes),
                    arg(&lines),
                    row.arg(),
                    arg(&points),
                    arg(&grad),
                    levels.arg(),
                    arg(&out.planes),
                    arg(&out.lines),
                    arg(&out.points),
                    parts.arg(),
                    n as u32,
                    shape.channels as u32,
                    features as u32,
                )
            };
        }
        if path::native_atomics(&client) {
            go!(Native)
        } else {
            go!(Exchange)
        }
        let (lo, hi, frac) = time_tap(&shape, time);
        sum_times::launch(
            &client,
            cubes(features, 1),
            CubeDim::new_1d(UNITS),
            parts.arg(),
            arg(&out.times),
            launched as u32,
            shape.time_knots as u32,
            shape.channels as u32,
            features as u32,
            lo,
            hi,
            frac,
        );
        out
    }
}
