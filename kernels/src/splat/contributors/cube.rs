//! Contributors on a GPU: one unit per pixel walks its tile's list twice, to count and to write. Only the lists are
//! read back.
// compile-time conditions of a kernel are kept apart from those of its units
#![allow(clippy::collapsible_if)]

use super::{Contributors, ContributorsOps, ContributorsOutput, check_pixels};
use crate::cube::prelude::*;
use crate::cube::{UNITS, Words, cubes, scan};
use crate::splat::cube::rule::{clamped, log_alpha};
use crate::splat::cube::{TILE, binned, tiles};
use crate::splat::{ALPHA_MIN, SplatSettings, SplatTensors, TRANSMITTANCE_MIN};

/// Counts the contributions of each pixel into `starts`, or, with `write`, lists them from there on. The compositing
/// rule is that of blending.
#[cube(launch)]
fn walk(
    screen: &[f32],
    gaussians: &[u32],
    sorted: &[u32],
    tile_starts: &[u32],
    pixels: &[u32],
    starts: &mut [u32],
    indices: &mut [u32],
    weights: &mut [f32],
    count: u32,
    width: u32,
    tiles_x: u32,
    #[comptime] write: bool,
) {
    if ABSOLUTE_POS < count as usize {
        let pixel = pixels[ABSOLUTE_POS];
        let (column, row) = (pixel % width, pixel / width);
        let tile = (row / comptime!(TILE as u32) * tiles_x + column / comptime!(TILE as u32)) as usize;
        let px = f32::cast_from(column) + 0.5f32;
        let py = f32::cast_from(row) + 0.5f32;
        let mut at = tile_starts[tile];
        let end = tile_starts[tile + 1];
        let mut left = 1.0f32;
        let mut done = false;
        let mut found = 0u32;
        let mut first = 0u32;
        if comptime!(write) {
            first = starts[ABSOLUTE_POS];
        }
        while at < end && !done {
            let gaussian = gaussians[sorted[at as usize] as usize];
            let from = gaussian as usize * 12;
            let dx = px - screen[from];
            let dy = py - screen[from + 1];
            let power = log_alpha(dx, dy, screen[from + 2], screen[from + 3], screen[from + 4], screen[from + 5]);
            if power >= comptime!(ALPHA_MIN.ln()) {
                let alpha = clamped(f32::exp(power));
                let weight = left * alpha;
                let after = left - weight;
                if after > comptime!(TRANSMITTANCE_MIN) {
                    if comptime!(write) {
                        indices[(first + found) as usize] = gaussian;
                        weights[(first + found) as usize] = weight;
                    }
                    found += 1u32;
                    left = after;
                } else {
                    done = true;
                }
            }
            at += 1u32;
        }
        if comptime!(!write) {
            starts[ABSOLUTE_POS] = found;
        }
    } else if comptime!(!write) {
        if ABSOLUTE_POS == count as usize {
            starts[ABSOLUTE_POS] = 0u32;
        }
    }
}

impl ContributorsOps for CubeBackend {
    fn contributors(inputs: SplatTensors<Self>, settings: SplatSettings, pixels: Vec<u32>) -> ContributorsOutput<Self> {
        let client = inputs.means.client.clone();
        let binned = binned(inputs, &settings, true);
        let (count, bins) = (pixels.len(), &binned.bins);
        let wanted = Words::u32s(&client, if pixels.is_empty() { &[0] } else { &pixels });
        let starts = Words::empty(&client, count + 1);
        if let Err(error) = check_pixels(&pixels, &settings) {
            return ContributorsOutput { lists: Err(error), radii: binned.radii };
        }
        let launch = |indices: &Words, weights: &Words, write: bool| {
            walk::launch(
                &client,
                cubes(count + 1, UNITS),
                CubeDim::new_1d(UNITS),
                binned.screen.arg(),
                bins.gaussians.arg(),
                bins.sorted.arg(),
                bins.tiles.arg(),
                wanted.arg(),
                starts.arg(),
                indices.arg(),
                weights.arg(),
                count as u32,
                settings.camera.width as u32,
                tiles(&settings)[0] as u32,
                write,
            );
        };
        launch(&Words::empty(&client, 1), &Words::empty(&client, 1), false);
        scan::exclusive(&client, &starts);
        let offsets = starts.read(&client);
        let total = offsets[count] as usize;
        let (indices, weights) = (Words::empty(&client, total), Words::empty(&client, total));
        launch(&indices, &weights, true);
        let mut indices = indices.read(&client);
        indices.truncate(total);
        let weights = weights.read(&client).into_iter().take(total).map(f32::from_bits).collect();
        ContributorsOutput { lists: Ok(Contributors { offsets, indices, weights }), radii: binned.radii }
    }
}
