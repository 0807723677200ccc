//! Compositing of ray samples, forward and backward, over f32 slices. A task is a fixed number of rays, each with its
//! own samples and colours, so the bits do not depend on the number of threads.

use super::rays::RaySamples;
use rayon::prelude::*;

/// Rays per task.
const TASK: usize = 64;

/// Writes the colour over `background` and the alpha of each ray to `out` `[R, 4]`, from optical depths `[S]`, each at
/// least 0, and colours `[C, 3]`. A NaN affects only its own ray.
///
/// # Panics
/// If a slice does not fit `rays`.
pub fn forward(rays: &RaySamples, depths: &[f32], colours: &[f32], background: [f32; 3], out: &mut [f32]) {
    check(rays, depths.len(), colours.len(), out.len());
    out.par_chunks_mut(4 * TASK).enumerate().for_each(|(task, out)| {
        for (k, out) in out.chunks_exact_mut(4).enumerate() {
            let (mut seen, mut through) = ([0.0f32; 3], 1.0f32);
            for s in rays.of(task * TASK + k) {
                if let Some(row) = rays.row(s) {
                    let weight = through * opacity(depths[s]);
                    for c in 0..3 {
                        seen[c] += weight * colours[3 * row + c];
                    }
                }
                through *= (-depths[s]).exp();
            }
            for c in 0..3 {
                out[c] = seen[c] + through * background[c];
            }
            out[3] = 1.0 - through;
        }
    });
}

/// `1 - exp(-depth)`, accurate for small depths.
fn opacity(depth: f32) -> f32 {
    -(-depth).exp_m1()
}

/// Returns the weight `w_i` of each sample in what its ray sees, `[S]`.
///
/// # Panics
/// If the last of `offsets` `[R + 1]` is beyond the end of `depths` `[S]`.
pub fn weights(offsets: &[u32], depths: &[f32]) -> Vec<f32> {
    let mut out = vec![0.0; depths.len()];
    for ends in offsets.windows(2) {
        let mut through = 1.0f32;
        for s in ends[0] as usize..ends[1] as usize {
            out[s] = through * opacity(depths[s]);
            through *= (-depths[s]).exp();
        }
    }
    out
}

/// Computes the gradients of [`forward`] for `grad` `[R, 4]`: with respect to the depths into `grad_depths` `[S]`, with
/// respect to the colours into `grad_colours` `[C, 3]`.
///
/// Everything behind sample i, `B_i = sum_(j > i) w_j c_j + T_(n+1) background`, is seen through it, so that
/// `dC / dd_i = T_(i+1) c_i - B_i`; the derivative of alpha is `T_(n+1)`.
///
/// # Panics
/// If a slice does not fit `rays`.
pub fn backward(
    rays: &RaySamples,
    depths: &[f32],
    colours: &[f32],
    background: [f32; 3],
    grad: &[f32],
    grad_depths: &mut [f32],
    grad_colours: &mut [f32],
) {
    check(rays, depths.len(), colours.len(), grad.len());
    check(rays, grad_depths.len(), grad_colours.len(), grad.len());
    let mut tasks = Vec::with_capacity(rays.rays().div_ceil(TASK));
    let (mut all_depths, mut all_colours) = (grad_depths, grad_colours);
    for first in (0..rays.rays()).step_by(TASK) {
        let last = (first + TASK).min(rays.rays());
        let samples = rays.offsets[first] as usize..rays.offsets[last] as usize;
        let rows = rays.rows[samples.start]..rays.rows[samples.end];
        let (of_depths, rest) = all_depths.split_at_mut(samples.len());
        all_depths = rest;
        let (of_colours, rest) = all_colours.split_at_mut(3 * rows.len());
        all_colours = rest;
        tasks.push((first..last, of_depths, of_colours));
    }
    tasks.into_par_iter().for_each(|(task, of_depths, of_colours)| {
        let start = rays.offsets[task.start] as usize;
        let first_row = rays.rows[start] as usize;
        let mut through = Vec::new();
        for ray in task {
            let g = &grad[4 * ray..4 * ray + 4];
            let toward = |colour: &[f32]| g[0] * colour[0] + g[1] * colour[1] + g[2] * colour[2];
            let samples = rays.of(ray);
            through.clear();
            through.push(1.0f32);
            for s in samples.clone() {
                through.push(through[through.len() - 1] * (-depths[s]).exp());
            }
            let end = through[samples.len()];
            let mut behind = end * toward(&background);
            for (k, s) in samples.enumerate().rev() {
                let mut slope = g[3] * end - behind;
                if let Some(row) = rays.row(s) {
                    let (weight, colour) = (through[k] * opacity(depths[s]), &colours[3 * row..3 * row + 3]);
                    let value = toward(colour);
                    slope += through[k + 1] * value;
                    behind += weight * value;
                    let at = 3 * (row - first_row);
                    for c in 0..3 {
                        of_colours[at + c] = weight * g[c];
                    }
                }
                of_depths[s - start] = slope;
            }
        }
    });
}

fn check(rays: &RaySamples, depths: usize, colours: usize, out: usize) {
    assert_eq!(depths, rays.samples(), "depths: [S]");
    assert_eq!(colours, 3 * rays.coloured(), "colours: [C, 3]");
    assert_eq!(out, 4 * rays.rays(), "rays: [R, 4]");
}
