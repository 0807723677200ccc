//! Compositing of ray samples on a GPU: one unit per ray, so that every sum has a single owner.
#![allow(clippy::collapsible_if)] // the inner condition must not be read unless the outer one holds

use super::ops::{MarchBackwardOps, MarchOps, MarchTensors};
use super::rays::RaySamples;
use crate::cube::prelude::*;
use crate::cube::{UNITS, Words, arg, cubes, empty_f32, rows};

/// Rays per cube: one warp, as long rays hold up their neighbours.
const RAYS: u32 = UNITS / 8;

/// `1 - exp(-depth)`, from its series where the difference would lose half of its digits.
#[cube]
pub(crate) fn opacity(depth: f32) -> f32 {
    let series = depth * (1.0f32 - depth * (0.5f32 - depth * (1.0f32 / 6.0f32)));
    select(f32::abs(depth) < 0.01f32, series, 1.0f32 - f32::exp(-depth))
}

#[cube(launch)]
fn forward(
    depths: &[f32],
    colours: &[f32],
    offsets: &[u32],
    colour_rows: &[u32],
    out: &mut [f32],
    rays: u32,
    back0: f32,
    back1: f32,
    back2: f32,
) {
    if ABSOLUTE_POS < rays as usize {
        let ray = ABSOLUTE_POS;
        let mut through = 1.0f32;
        let mut seen0 = 0.0f32;
        let mut seen1 = 0.0f32;
        let mut seen2 = 0.0f32;
        let mut s = offsets[ray];
        let end = offsets[ray + 1];
        while s < end {
            let depth = depths[s as usize];
            let row = colour_rows[s as usize];
            if row < colour_rows[s as usize + 1] {
                let weight = through * opacity(depth);
                seen0 += weight * colours[3 * row as usize];
                seen1 += weight * colours[3 * row as usize + 1];
                seen2 += weight * colours[3 * row as usize + 2];
            }
            through *= f32::exp(-depth);
            s += 1u32;
        }
        out[4 * ray] = seen0 + through * back0;
        out[4 * ray + 1] = seen1 + through * back1;
        out[4 * ray + 2] = seen2 + through * back2;
        out[4 * ray + 3] = 1.0f32 - through;
    }
}

/// Walks each ray twice: for the total that it sees, weighted by its gradient, then for the part behind each sample.
#[cube(launch)]
fn backward(
    depths: &[f32],
    colours: &[f32],
    offsets: &[u32],
    colour_rows: &[u32],
    grad: &[f32],
    out_depths: &mut [f32],
    out_colours: &mut [f32],
    rays: u32,
    back0: f32,
    back1: f32,
    back2: f32,
) {
    if ABSOLUTE_POS < rays as usize {
        let ray = ABSOLUTE_POS;
        let g0 = grad[4 * ray];
        let g1 = grad[4 * ray + 1];
        let g2 = grad[4 * ray + 2];
        let g3 = grad[4 * ray + 3];
        let first = offsets[ray];
        let end = offsets[ray + 1];
        let mut through = 1.0f32;
        let mut behind = 0.0f32;
        let mut s = first;
        while s < end {
            let depth = depths[s as usize];
            let row = colour_rows[s as usize];
            if row < colour_rows[s as usize + 1] {
                let at = 3 * row as usize;
                let value = g0 * colours[at] + g1 * colours[at + 1] + g2 * colours[at + 2];
                behind += through * opacity(depth) * value;
            }
            through *= f32::exp(-depth);
            s += 1u32;
        }
        let last = through;
        behind += last * (g0 * back0 + g1 * back1 + g2 * back2);
        through = 1.0f32;
        s = first;
        while s < end {
            let depth = depths[s as usize];
            let row = colour_rows[s as usize];
            let next = through * f32::exp(-depth);
            let mut slope = g3 * last;
            if row < colour_rows[s as usize + 1] {
                let at = 3 * row as usize;
                let value = g0 * colours[at] + g1 * colours[at + 1] + g2 * colours[at + 2];
                let weight = through * opacity(depth);
                behind -= weight * value;
                slope += next * value;
                out_colours[at] = weight * g0;
                out_colours[at + 1] = weight * g1;
                out_colours[at + 2] = weight * g2;
            }
            out_depths[s as usize] = slope - behind;
            through = next;
            s += 1u32;
        }
    }
}

/// Uploads the offsets of rays and of colours to the device.
fn upload(like: &CubeTensor, rays: &RaySamples) -> [Words; 2] {
    [&rays.offsets, &rays.rows].map(|words| Words::u32s(&like.client, words))
}

impl MarchOps for CubeBackend {
    fn march_forward(inputs: MarchTensors<Self>, rays: RaySamples, background: [f32; 3]) -> FloatTensor<Self> {
        let [depths, colours] = inputs.into_array().map(rows);
        let [offsets, colour_rows] = upload(&depths, &rays);
        let out = empty_f32(&depths, [rays.rays(), 4]);
        let [back0, back1, back2] = background;
        forward::launch(
            &depths.client,
            cubes(rays.rays(), RAYS),
            CubeDim::new_1d(RAYS),
            arg(&depths),
            arg(&colours),
            offsets.arg(),
            colour_rows.arg(),
            arg(&out),
            rays.rays() as u32,
            back0,
            back1,
            back2,
        );
        out
    }
}

impl MarchBackwardOps for CubeBackend {
    fn march_backward(
        inputs: MarchTensors<Self>,
        grad: FloatTensor<Self>,
        rays: RaySamples,
        background: [f32; 3],
    ) -> MarchTensors<Self> {
        let [depths, colours] = inputs.into_array().map(rows);
        let [offsets, colour_rows] = upload(&depths, &rays);
        let out = [&depths, &colours].map(|t| empty_f32(t, t.meta.shape().clone()));
        let [back0, back1, back2] = background;
        backward::launch(
            &depths.client,
            cubes(rays.rays(), RAYS),
            CubeDim::new_1d(RAYS),
            arg(&depths),
            arg(&colours),
            offsets.arg(),
            colour_rows.arg(),
            arg(&rows(grad)),
            arg(&out[0]),
            arg(&out[1]),
            rays.rays() as u32,
            back0,
            back1,
            back2,
        );
        MarchTensors::from(out)
    }
}
