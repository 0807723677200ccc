//! Front-to-back blending: one cube per tile, one unit per pixel, Gaussians staged through shared memory.

use super::rule::{clamped, log_alpha};
use super::{BATCH, SEGMENT, TILE};
use crate::cube::prelude::*;
use crate::splat::{ALPHA_MIN, TRANSMITTANCE_MIN};

/// Renders `image` `[H, W, 4]`. With `save`, also stores the states from which the backward pass starts: at every
/// [`SEGMENT`]-th entry of a tile, the transmittance (negative once a pixel is finished) and colour of its pixels,
/// `[segments, 4, 256]`, and the number of entries that each tile examined before all its pixels were finished.
#[cube(launch)]
pub(super) fn blend(
    screen: &[f32],
    gaussians: &[u32],
    sorted: &[u32],
    tiles: &[u32],
    image: &mut [f32],
    states: &mut [f32],
    used: &mut [u32],
    width: u32,
    height: u32,
    tiles_x: u32,
    tile_count: u32,
    background_red: f32,
    background_green: f32,
    background_blue: f32,
    #[comptime] save: bool,
) {
    let mut staged = Shared::<[f32]>::new_slice(comptime!((BATCH * 9) as usize));
    let live = Shared::<[Atomic<u32>]>::new_slice(1usize);
    let tile = min(CUBE_POS as u32, tile_count - 1u32);
    let size = comptime!(TILE as u32);
    let column = (tile % tiles_x) * size + UNIT_POS % size;
    let row = (tile / tiles_x) * size + UNIT_POS / size;
    let inside = column < width && row < height && (CUBE_POS as u32) < tile_count;
    let px = f32::cast_from(column) + 0.5f32;
    let py = f32::cast_from(row) + 0.5f32;
    let start = tiles[tile as usize];
    let end = tiles[tile as usize + 1];
    let first_segment = start / comptime!(SEGMENT) + tile;

    let mut left = select(inside, 1.0f32, 0.0f32);
    let mut done = !inside;
    let mut red = 0.0f32;
    let mut green = 0.0f32;
    let mut blue = 0.0f32;
    let mut base = start;
    let mut goes_on = true;
    while goes_on && base < end {
        let count = min(comptime!(BATCH), end - base);
        if UNIT_POS < count {
            let from = gaussians[sorted[(base + UNIT_POS) as usize] as usize] as usize * 12;
            let to = (UNIT_POS * 9u32) as usize;
            #[unroll]
            for k in 0..9usize {
                staged[to + k] = screen[from + k];
            }
        }
        if UNIT_POS == 0u32 {
            Atomic::store(&live[0], 0u32);
        }
        sync_cube();
        #[unroll]
        for part in 0..comptime!(BATCH / SEGMENT) {
            let from = min(part * comptime!(SEGMENT), count);
            let to = min(from + comptime!(SEGMENT), count);
            if comptime!(save) {
                if from < to && (CUBE_POS as u32) < tile_count {
                    let segment = first_segment + (base - start) / comptime!(SEGMENT) + part;
                    let at = (segment * 1024u32 + UNIT_POS) as usize;
                    states[at] = left;
                    states[at + 256] = red;
                    states[at + 512] = green;
                    states[at + 768] = blue;
                }
            }
            let mut k = from;
            while k < to && !done {
                let at = (k * 9u32) as usize;
                let dx = px - staged[at];
                let dy = py - staged[at + 1];
                let power = log_alpha(dx, dy, staged[at + 2], staged[at + 3], staged[at + 4], staged[at + 5]);
                if power >= comptime!(ALPHA_MIN.ln()) {
                    let alpha = clamped(f32::exp(power));
                    let weight = left * alpha;
                    let after = left - weight;
                    if after > comptime!(TRANSMITTANCE_MIN) {
                        red += weight * staged[at + 6];
                        green += weight * staged[at + 7];
                        blue += weight * staged[at + 8];
                        left = after;
                    } else {
                        done = true;
                        left = -left;
                    }
                }
                k += 1u32;
            }
        }
        if !done {
            Atomic::fetch_add(&live[0], 1u32);
        }
        base += count;
        let alive = workgroup_uniform_load_atomic(&live[0]);
        // a barrier follows that load on WGSL only; elsewhere unit 0 could reset the count before all have read it
        sync_cube();
        goes_on = alive > 0u32;
    }
    if comptime!(save) {
        if UNIT_POS == 0u32 && (CUBE_POS as u32) < tile_count {
            used[tile as usize] = base - start;
        }
    }
    if inside {
        let rest = f32::abs(left);
        let at = ((row * width + column) * 4u32) as usize;
        image[at] = red + rest * background_red;
        image[at + 1] = green + rest * background_green;
        image[at + 2] = blue + rest * background_blue;
        image[at + 3] = 1.0f32 - rest;
    }
}
