//! Gradients of blending with respect to the projected Gaussians, one unit per Gaussian.
//!
//! A cube of [`LINE`] units replays a segment of a tile's list front to back, a line of Gaussians at a time. The
//! pixels' transmittance and the part of each still behind are kept in shared memory; pixel p meets Gaussian i of the
//! line in step p + i, after Gaussian i - 1, as in a pipeline. Each unit thus sums its own Gaussian's gradient in
//! registers and writes it once: no atomics, no plane operations, and always the same order.
//!
//! As on the CPU, with V the gradient of a pixel, `S` starts as `V . C` of the part not replayed yet and loses the
//! contribution of each Gaussian in turn; then `dL/dalpha = T (V . c) - S / (1 - alpha)`.

use super::rule::{clamped, log_alpha};
use super::{LINE, SEGMENT, TILE};
use crate::cube::prelude::*;
use crate::splat::{ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN};

/// Clears the sums of entries that were listed in no tile: they were counted, and then not found again.
#[cube(launch)]
pub(super) fn clear_unlisted(
    sorted: &[u32],
    tiles: &[u32],
    starts: &[u32],
    sums: &mut [f32],
    tile_count: u32,
    n: u32,
    capacity: u32,
) {
    let end = min(starts[n as usize], capacity);
    let mut at = tiles[tile_count as usize] + UNIT_POS;
    while at < end {
        let to = sorted[at as usize] as usize * 9;
        #[unroll]
        for k in 0..9usize {
            sums[to + k] = 0.0f32;
        }
        at += CUBE_DIM;
    }
}

/// Writes for each entry u, u dx, u dy, u dx^2, u dx dy, u dy^2 with u = dL/dpower, and dL/dcolour: `sums` `[E, 9]`, in
/// the order in which the entries were listed, so that those of one Gaussian are consecutive.
#[cube(launch)]
pub(super) fn blend_backward(
    screen: &[f32],
    gaussians: &[u32],
    sorted: &[u32],
    tiles: &[u32],
    used: &[u32],
    states: &[f32],
    image: &[f32],
    grad: &[f32],
    sums: &mut [f32],
    width: u32,
    height: u32,
    tiles_x: u32,
    tile_count: u32,
) {
    // transmittance, the part behind, and the four gradients of each pixel of the tile
    let mut pixels = Shared::<[f32]>::new_slice(1536usize);
    let segment = CUBE_POS as u32;
    // the last tile whose first segment does not come after this one
    let mut low = 0u32;
    let mut high = tile_count;
    while high - low > 1u32 {
        let middle = (low + high) / 2u32;
        if tiles[middle as usize] / comptime!(SEGMENT) + middle <= segment {
            low = middle;
        } else {
            high = middle;
        }
    }
    let tile = low;
    let tile_start = tiles[tile as usize];
    let tile_end = tiles[tile as usize + 1];
    let first = min(tile_start + (segment - (tile_start / comptime!(SEGMENT) + tile)) * comptime!(SEGMENT), tile_end);
    let end = min(first + comptime!(SEGMENT), tile_end);
    let used_end = min(tile_start + used[tile as usize], end);

    let size = comptime!(TILE as u32);
    let x0 = (tile % tiles_x) * size;
    let y0 = (tile / tiles_x) * size;
    if first < used_end {
        for k in 0..comptime!(256 / LINE) {
            let p = k * comptime!(LINE) + UNIT_POS;
            let (column, row) = (x0 + p % size, y0 + p / size);
            let mut left = 0.0f32;
            let mut behind = 0.0f32;
            let mut v0 = 0.0f32;
            let mut v1 = 0.0f32;
            let mut v2 = 0.0f32;
            let mut v3 = 0.0f32;
            if column < width && row < height {
                let at = ((row * width + column) * 4u32) as usize;
                let state = (segment * 1024u32 + p) as usize;
                v0 = grad[at];
                v1 = grad[at + 1];
                v2 = grad[at + 2];
                v3 = grad[at + 3];
                left = states[state];
                behind = v0 * (image[at] - states[state + 256])
                    + v1 * (image[at + 1] - states[state + 512])
                    + v2 * (image[at + 2] - states[state + 768])
                    + v3 * (image[at + 3] - (1.0f32 - f32::abs(left)));
            }
            let at = p as usize;
            pixels[at] = left;
            pixels[at + 256] = behind;
            pixels[at + 512] = v0;
            pixels[at + 768] = v1;
            pixels[at + 1024] = v2;
            pixels[at + 1280] = v3;
        }
    }
    sync_cube();
    let mut base = first;
    while base < end {
        let index = base + UNIT_POS;
        let mut sum = Array::<f32>::new(9usize);
        #[unroll]
        for k in 0..9usize {
            sum[k] = 0.0f32;
        }
        // uniform over all units: a line after the last used entry has nothing to do
        if base < used_end {
            let takes = index < used_end;
            let mut own = Array::<f32>::new(9usize);
            #[unroll]
            for k in 0..9usize {
                own[k] = 0.0f32;
            }
            if takes {
                let from = gaussians[sorted[index as usize] as usize] as usize * 12;
                #[unroll]
                for k in 0..9usize {
                    own[k] = screen[from + k];
                }
            }
            for step in 0..comptime!(256 + LINE - 1) {
                if takes && step >= UNIT_POS && step - UNIT_POS < 256u32 {
                    let p = step - UNIT_POS;
                    let at = p as usize;
                    let left = pixels[at];
                    if left > 0.0f32 {
                        let dx = f32::cast_from(x0 + p % size) + 0.5f32 - own[0];
                        let dy = f32::cast_from(y0 + p / size) + 0.5f32 - own[1];
                        let power = log_alpha(dx, dy, own[2], own[3], own[4], own[5]);
                        if power >= comptime!(ALPHA_MIN.ln()) {
                            let unclamped = f32::exp(power);
                            let alpha = clamped(unclamped);
                            let weight = left * alpha;
                            let after = left - weight;
                            if after > comptime!(TRANSMITTANCE_MIN) {
                                let v0 = pixels[at + 512];
                                let v1 = pixels[at + 768];
                                let v2 = pixels[at + 1024];
                                // the fourth channel is alpha, to which every Gaussian contributes its full weight
                                let vc = v0 * own[6] + v1 * own[7] + v2 * own[8] + pixels[at + 1280];
                                let rest = pixels[at + 256] - weight * vc;
                                pixels[at + 256] = rest;
                                pixels[at] = after;
                                if unclamped <= comptime!(ALPHA_MAX) {
                                    let u = alpha * (left * vc - rest / (1.0f32 - alpha));
                                    sum[0] += u;
                                    sum[1] += u * dx;
                                    sum[2] += u * dy;
                                    sum[3] += u * dx * dx;
                                    sum[4] += u * dx * dy;
                                    sum[5] += u * dy * dy;
                                }
                                sum[6] += weight * v0;
                                sum[7] += weight * v1;
                                sum[8] += weight * v2;
                            } else {
                                pixels[at] = -left;
                            }
                        }
                    }
                }
                sync_cube();
            }
        }
        if index < end {
            let to = sorted[index as usize] as usize * 9;
            #[unroll]
            for k in 0..9usize {
                sums[to + k] = sum[k];
            }
        }
        base += comptime!(LINE);
    }
}
