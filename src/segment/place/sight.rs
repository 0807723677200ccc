//! Places that nobody can see into: the interiors of opaque bodies.

use crate::volume::grid::Grid;
use rayon::prelude::*;

/// Share of a ray's light up to which trained pictures do not tell whether anything is in its way: their usual error,
/// that of a PSNR of 34 dB.
const UNSEEN: f64 = 0.02;
/// Share of the light of a place, over all directions, from which on one can look into it, as into a cup.
const OPEN: f64 = 0.25;

/// One step of a ray through the grid.
#[derive(Clone, Copy)]
struct Step {
    by: [isize; 3],
    length: f64,
}

/// Returns the hidden cells `[z, y, x]`, given the extinction density `[z, y, x]` of everything, per unit of length.
///
/// A cell is hidden if matter in it would change no picture: of the light on the 13 lines through it and its
/// neighbours, all across the grid, less than 2 % gets through in the mean. A cavity that is open to the outside is not
/// hidden though the lines end at its back: there, a quarter of the light or more leaves in the mean over the 26
/// directions.
pub fn hidden(density: &[f32], grid: &Grid) -> Vec<bool> {
    let [x, y, z] = grid.dims;
    let steps = steps(grid.spacing);
    let (lines, ways) = (UNSEEN * steps.len() as f64, OPEN * 2.0 * steps.len() as f64);
    let mut hidden = vec![false; density.len()];
    let Some(reach) = reach(density, grid.dims) else { return hidden };
    let [[x0, x1], [y0, y1], [z0, z1]] = reach;
    let inside = |at: [isize; 3]| (0..3).all(|k| at[k] >= reach[k][0] as isize && at[k] <= reach[k][1] as isize);
    let depth = |from: [usize; 3], step: &Step, sign: isize| {
        let by = step.by.map(|b| sign * b);
        let stride = by[0] + by[1] * x as isize + by[2] * (x * y) as isize;
        let mut cell = (from[2] * y + from[1]) * x + from[0];
        let mut at = from.map(|v| v as isize);
        let mut sum = 0.5 * f64::from(density[cell]);
        loop {
            (0..3).for_each(|k| at[k] += by[k]);
            // beyond the box of what there is, nothing is in the way
            if !inside(at) {
                return sum * step.length;
            }
            cell = cell.wrapping_add_signed(stride);
            sum += f64::from(density[cell]);
        }
    };
    debug_assert_eq!(density.len(), x * y * z);
    hidden.par_chunks_mut(x * y).enumerate().skip(z0).take(z1 + 1 - z0).for_each(|(k, out)| {
        for j in y0..=y1 {
            for i in x0..=x1 {
                let (mut through, mut out_of) = (0.0, 0.0);
                out[j * x + i] = steps.iter().all(|step| {
                    let [there, back] = [1, -1].map(|sign| depth([i, j, k], step, sign));
                    through += (-there - back).exp();
                    out_of += (-there).exp() + (-back).exp();
                    through < lines && out_of < ways
                });
            }
        }
    });
    hidden
}

/// Steps to 13 neighbours; the other 13 are in the opposite directions.
fn steps(spacing: [f64; 3]) -> Vec<Step> {
    let mut steps = Vec::with_capacity(13);
    for code in 0..13 {
        let by = [code % 3 - 1, code / 3 % 3 - 1, code / 9 - 1];
        let length = (0..3).map(|k| (by[k] as f64 * spacing[k]).powi(2)).sum::<f64>().sqrt();
        steps.push(Step { by, length });
    }
    steps
}

/// Returns the first and last cells along x, y, z that hold anything.
fn reach(density: &[f32], [x, y, _]: [usize; 3]) -> Option<[[usize; 2]; 3]> {
    let (mut low, mut high) = ([usize::MAX; 3], [0; 3]);
    for (row, values) in density.chunks_exact(x).enumerate() {
        let Some(first) = values.iter().position(|v| *v > 0.0) else { continue };
        let last = values.iter().rposition(|v| *v > 0.0).unwrap_or(first);
        for (k, [from, to]) in [[first, last], [row % y; 2], [row / y; 2]].into_iter().enumerate() {
            low[k] = low[k].min(from);
            high[k] = high[k].max(to);
        }
    }
    (low[0] != usize::MAX).then(|| std::array::from_fn(|k| [low[k], high[k]]))
}
