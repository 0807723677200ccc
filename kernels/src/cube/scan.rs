//! Exclusive prefix sums of u32 buffers, in place.

use super::{Words, cubes};
use crate::cube::prelude::*;

/// Units per cube.
const UNITS: u32 = 256;
/// Elements per cube when the buffer is split into blocks.
const BLOCK: usize = 2048;
/// Maximum number of elements scanned by a single cube.
const ONE_CUBE_MAX: usize = 8192;

/// Replaces each element by the sum of those before it.
pub(crate) fn exclusive(client: &Client, data: &Words) {
    let len = data.len();
    if len <= ONE_CUBE_MAX {
        one_cube::launch(client, CubeCount::Static(1, 1, 1), CubeDim::new_1d(UNITS), data.arg(), len as u32);
        return;
    }
    let blocks = len.div_ceil(BLOCK);
    let sums = Words::empty(client, blocks);
    let count = cubes(blocks, 1);
    sum_blocks::launch(client, count.clone(), CubeDim::new_1d(UNITS), data.arg(), sums.arg(), len as u32);
    exclusive(client, &sums);
    scan_blocks::launch(client, count, CubeDim::new_1d(UNITS), data.arg(), sums.arg(), len as u32);
}

/// Returns the sum of `mine` over the units before this one; all `units` of the cube must call it.
#[cube]
pub(crate) fn before_me(mine: u32, #[comptime] units: u32) -> u32 {
    let mut sums = Shared::<[u32]>::new_slice(comptime!(units as usize));
    let unit = UNIT_POS as usize;
    sums[unit] = mine;
    sync_cube();
    let mut step = 1u32;
    while step < units {
        let mut value = sums[unit];
        if UNIT_POS >= step {
            value += sums[(UNIT_POS - step) as usize];
        }
        sync_cube();
        sums[unit] = value;
        sync_cube();
        step *= 2u32;
    }
    sums[unit] - mine
}

/// Scans `[from, to)` of `data`, a run of consecutive elements per unit, starting from the sum `start`.
#[cube]
fn scan_range(data: &mut [u32], from: u32, to: u32, start: u32) {
    let each = (to - from).div_ceil(256u32);
    let first = min(from + UNIT_POS * each, to);
    let last = min(first + each, to);
    let mut sum = 0u32;
    for i in first..last {
        sum += data[i as usize];
    }
    let mut running = before_me(sum, UNITS) + start;
    for i in first..last {
        let value = data[i as usize];
        data[i as usize] = running;
        running += value;
    }
}

#[cube(launch)]
fn one_cube(data: &mut [u32], len: u32) {
    scan_range(data, 0u32, len, 0u32);
}

#[cube(launch)]
fn sum_blocks(data: &[u32], sums: &mut [u32], len: u32) {
    let block = CUBE_POS as u32;
    let from = min(block * 2048u32, len);
    let to = min(from + 2048u32, len);
    let mut sum = 0u32;
    let mut i = from + UNIT_POS;
    while i < to {
        sum += data[i as usize];
        i += 256u32;
    }
    let before = before_me(sum, UNITS);
    if UNIT_POS == 255u32 && from < len {
        sums[block as usize] = before + sum;
    }
}

#[cube(launch)]
fn scan_blocks(data: &mut [u32], sums: &[u32], len: u32) {
    let block = CUBE_POS as u32;
    let from = min(block * 2048u32, len);
    let to = min(from + 2048u32, len);
    let mut start = 0u32;
    if from < len {
        start = sums[block as usize];
    }
    scan_range(data, from, to, start);
}
