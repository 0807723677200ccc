//! A stable radix sort of u32 keys with u32 values, four bits per pass, for a length that only the device knows.
//!
//! Each pass counts digits block by block, scans the counts, and scatters; within a block the counters of all units are
//! scanned digit by digit, so that equal keys keep their order. It uses neither plane operations nor atomics.

use super::{Words, cubes, scan};
use crate::cube::prelude::*;

/// Units per cube.
const UNITS: u32 = 128;
/// Consecutive elements per unit.
const ELEMENTS_PER_UNIT: u32 = 16;
/// Elements per cube.
const BLOCK: usize = (UNITS * ELEMENTS_PER_UNIT) as usize;
/// Digit values per pass.
const DIGITS: usize = 16;

/// Sorts the first `len[0]` keys (at most their capacity) by their low `bits` bits, with their values. Elements beyond
/// them are unspecified.
pub(crate) fn by_key(client: &Client, keys: Words, values: Words, len: &Words, bits: u32) -> (Words, Words) {
    let capacity = keys.len();
    let blocks = capacity.div_ceil(BLOCK).max(1);
    let (mut keys, mut values) = (keys, values);
    let (mut other_keys, mut other_values) = (Words::empty(client, capacity), Words::empty(client, capacity));
    let counts = Words::empty(client, DIGITS * blocks);
    for pass in 0..bits.div_ceil(4) {
        let (count, dim, shift) = (cubes(blocks, 1), CubeDim::new_1d(UNITS), 4 * pass);
        count_digits::launch(
            client,
            count.clone(),
            dim,
            keys.arg(),
            len.arg(),
            counts.arg(),
            blocks as u32,
            capacity as u32,
            shift,
        );
        scan::exclusive(client, &counts);
        scatter::launch(
            client,
            count,
            dim,
            keys.arg(),
            values.arg(),
            len.arg(),
            counts.arg(),
            other_keys.arg(),
            other_values.arg(),
            blocks as u32,
            capacity as u32,
            shift,
        );
        std::mem::swap(&mut keys, &mut other_keys);
        std::mem::swap(&mut values, &mut other_values);
    }
    (keys, values)
}

/// Counts the digits of this unit's elements into its column of `counters` `[16, 128]`.
#[cube]
fn count_mine(keys: &[u32], counters: &mut Shared<[u32]>, from: u32, to: u32, shift: u32) {
    #[unroll]
    for digit in 0..16usize {
        counters[digit * 128 + UNIT_POS as usize] = 0u32;
    }
    for i in from..to {
        let digit = (keys[i as usize] >> shift) & 15u32;
        let at = (digit * 128u32 + UNIT_POS) as usize;
        counters[at] += 1u32;
    }
}

#[cube(launch)]
fn count_digits(keys: &[u32], len: &[u32], counts: &mut [u32], blocks: u32, capacity: u32, shift: u32) {
    let mut counters = Shared::<[u32]>::new_slice(2048usize);
    let mut sums = Shared::<[u32]>::new_slice(128usize);
    let n = min(len[0], capacity);
    let block = CUBE_POS as u32;
    let from = min((block * 128u32 + UNIT_POS) * 16u32, n);
    let to = min(from + 16u32, n);
    count_mine(keys, &mut counters, from, to, shift);
    sync_cube();
    // eight units sum one digit's 128 counters
    let mut sum = 0u32;
    for k in 0..16u32 {
        sum += counters[(UNIT_POS * 16u32 + k) as usize];
    }
    sums[UNIT_POS as usize] = sum;
    sync_cube();
    if UNIT_POS < 16u32 && block < blocks {
        let mut total = 0u32;
        for k in 0..8u32 {
            total += sums[(UNIT_POS * 8u32 + k) as usize];
        }
        counts[(UNIT_POS * blocks + block) as usize] = total;
    }
}

#[cube(launch)]
fn scatter(
    keys: &[u32],
    values: &[u32],
    len: &[u32],
    starts: &[u32],
    out_keys: &mut [u32],
    out_values: &mut [u32],
    blocks: u32,
    capacity: u32,
    shift: u32,
) {
    let mut counters = Shared::<[u32]>::new_slice(2048usize);
    let mut firsts = Shared::<[u32]>::new_slice(16usize);
    let n = min(len[0], capacity);
    let block = CUBE_POS as u32;
    let from = min((block * 128u32 + UNIT_POS) * 16u32, n);
    let to = min(from + 16u32, n);
    count_mine(keys, &mut counters, from, to, shift);
    sync_cube();
    // exclusive scan of the counters, digit by digit and unit by unit
    let mut sum = 0u32;
    for k in 0..16u32 {
        sum += counters[(UNIT_POS * 16u32 + k) as usize];
    }
    let mut running = scan::before_me(sum, UNITS);
    for k in 0..16u32 {
        let at = (UNIT_POS * 16u32 + k) as usize;
        let value = counters[at];
        counters[at] = running;
        running += value;
    }
    sync_cube();
    if UNIT_POS < 16u32 {
        firsts[UNIT_POS as usize] = counters[(UNIT_POS * 128u32) as usize];
    }
    sync_cube();
    for i in from..to {
        let key = keys[i as usize];
        let digit = (key >> shift) & 15u32;
        let at = (digit * 128u32 + UNIT_POS) as usize;
        let place = counters[at];
        counters[at] = place + 1u32;
        let to = (starts[(digit * blocks + block) as usize] + place - firsts[digit as usize]) as usize;
        out_keys[to] = key;
        out_values[to] = values[i as usize];
    }
}
