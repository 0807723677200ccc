//! Sums over a buffer in a fixed order: units, then cubes.

use super::{UNITS, Words};
use crate::cube::prelude::*;

/// Returns the sum of `value` over the 256 units of a cube, valid in unit 0; all units must call it.
#[cube]
pub(crate) fn over_cube(value: f32) -> f32 {
    let mut sums = Shared::<[f32]>::new_slice(256usize);
    sums[UNIT_POS as usize] = value;
    sync_cube();
    let mut half = 128u32;
    while half > 0u32 {
        if UNIT_POS < half {
            let other = sums[(UNIT_POS + half) as usize];
            sums[UNIT_POS as usize] += other;
        }
        sync_cube();
        half /= 2u32;
    }
    let total = sums[0];
    sync_cube();
    total
}

/// Writes the sum of `parts` (`[count]` words of f32), times `factor`, to the tensor `out` `[1]`.
pub(crate) fn total(client: &Client, parts: &Words, out: &CubeTensor, factor: f32) {
    sum_parts::launch(
        client,
        CubeCount::Static(1, 1, 1),
        CubeDim::new_1d(UNITS),
        parts.arg(),
        super::arg(out),
        parts.len() as u32,
        factor,
    );
}

#[cube(launch)]
fn sum_parts(parts: &[f32], out: &mut [f32], count: u32, factor: f32) {
    let mut sum = 0.0f32;
    let mut i = UNIT_POS;
    while i < count {
        sum += parts[i as usize];
        i += 256u32;
    }
    let total = over_cube(sum);
    if UNIT_POS == 0u32 {
        out[0] = total * factor;
    }
}
