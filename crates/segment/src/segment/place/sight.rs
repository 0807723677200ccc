//! Places that nobody can see into: the interiors of opaque bodies.

use crate::volume::grid::Grid;
use rayon::prelude::*;
use std::ops::Range;

/// Share of a ray's light up to which trained pictures do not tell whether anything is in its way: their usual error,
/// that of a PSNR of 34 dB.
const UNSEEN: f64 = 0.02;
/// Share of the light of a place, over all directions, from which on one can look into it, as into a cup.
const OPEN: f64 = 0.25;

/// Cells per task.
const CHUNK: usize = 1 << 14;

/// One step of a ray through the grid.
#[derive(Clone, Copy)]
struct RayStep {
    by: [isize; 3],
    length: f64,
}

/// The light that leaves a cell.
#[derive(Clone, Copy, Default)]
struct CellLight {
    /// Of the lines through it, the sum of the shares that get through.
    through: f64,
    /// Over the ways out of it, the sum of the shares that get out.
    out: f64,
}

/// Returns the hidden cells `[z, y, x]`, given the extinction density `[z, y, x]` of everything, per unit of length.
///
/// A place is hidden if matter in it would change no picture: of the light on the 13 lines through it and its
/// neighbours, all across the grid, less than 2 % gets through in the mean. A cavity that is open to the outside is not
/// hidden though the lines end at its back: there, a quarter of the light or more leaves in the mean over the 26
/// directions. Light is followed on cells of twice the size, where it passes through fewer gaps between Gaussians that
/// no picture resolves.
pub fn hidden(density: &[f32], grid: &Grid) -> Vec<bool> {
    let mut hidden = vec![false; density.len()];
    let Some(reach) = reach(density, grid.dims) else { return hidden };
    // beyond the box of what there is, nothing is in the way
    let first = reach.map(|[low, _]| low);
    let pairs = reach.map(|[low, high]| (high + 1 - low).div_ceil(2));
    let dark = dark(&pooled(density, grid.dims, first, pairs), pairs, grid.spacing.map(|s| 2.0 * s));
    for (row, dark) in dark.chunks_exact(pairs[0]).enumerate() {
        for cells in rows_of(row, grid.dims, first, pairs) {
            hidden[cells].chunks_mut(2).zip(dark).for_each(|(pair, dark)| pair.fill(*dark));
        }
    }
    hidden
}

/// The up to four rows of cells that a row of pairs along x is made of, from the cell `first` on.
fn rows_of(
    row: usize,
    [x, y, z]: [usize; 3],
    first: [usize; 3],
    pairs: [usize; 3],
) -> impl Iterator<Item = Range<usize>> {
    let [j, k] = [first[1] + 2 * (row % pairs[1]), first[2] + 2 * (row / pairs[1])];
    let inside = [(j, k), (j + 1, k), (j, k + 1), (j + 1, k + 1)].into_iter().filter(move |(j, k)| *j < y && *k < z);
    inside.map(move |(j, k)| (k * y + j) * x).map(move |start| start + first[0]..start + x)
}

/// The mean density of groups of two cells along each axis, `pairs` of them from the cell `first`; beyond the grid there
/// is nothing.
fn pooled(density: &[f32], dims: [usize; 3], first: [usize; 3], pairs: [usize; 3]) -> Vec<f32> {
    let mut out = vec![0.0f32; pairs.iter().product()];
    out.par_chunks_mut(pairs[0]).enumerate().for_each(|(row, out)| {
        for cells in rows_of(row, dims, first, pairs) {
            for (out, pair) in out.iter_mut().zip(density[cells].chunks(2)) {
                *out += 0.125 * pair.iter().sum::<f32>();
            }
        }
    });
    out
}

/// Which cells of a density, all alike, are hidden.
fn dark(density: &[f32], dims: [usize; 3], spacing: [f64; 3]) -> Vec<bool> {
    let steps = steps(spacing);
    let (lines, ways) = (UNSEEN * steps.len() as f64, OPEN * 2.0 * steps.len() as f64);
    let mut light = vec![CellLight::default(); density.len()];
    for step in &steps {
        let (there, back) =
            rayon::join(|| sums_beyond(density, dims, step.by), || sums_beyond(density, dims, step.by.map(|b| -b)));
        let chunks = light.par_chunks_mut(CHUNK).zip(density.par_chunks(CHUNK));
        chunks.zip(there.par_chunks(CHUNK).zip(back.par_chunks(CHUNK))).for_each(|((light, own), (there, back))| {
            for ((light, own), (there, back)) in light.iter_mut().zip(own).zip(there.iter().zip(back)) {
                // once a cell is seen, nothing hides it
                if light.through < lines && light.out < ways {
                    let [there, back] = [there, back].map(|sum| step.length * (0.5 * f64::from(*own) + sum));
                    light.through += (-there - back).exp();
                    light.out += (-there).exp() + (-back).exp();
                }
            }
        });
    }
    light.iter().map(|light| light.through < lines && light.out < ways).collect()
}

/// Returns for each cell the sum of the densities of the cells that follow it in steps `by`.
fn sums_beyond(density: &[f32], [x, y, z]: [usize; 3], by: [isize; 3]) -> Vec<f64> {
    let mut sums = vec![0.0f64; density.len()];
    let stride = by[0] + by[1] * x as isize + by[2] * (x * y) as isize;
    let from = by[0].min(0).unsigned_abs();
    let Some(n) = x.checked_sub(by[0].unsigned_abs()) else { return sums };
    // cells come after those that follow them: from the end if steps go forward
    let ordered = |n: usize, i: usize| if stride > 0 { n - 1 - i } else { i };
    for r in (0..y * z).map(|i| ordered(y * z, i)) {
        let next = match [(r % y).checked_add_signed(by[1]), (r / y).checked_add_signed(by[2])] {
            [Some(j), Some(k)] if j < y && k < z => k * y + j,
            _ => continue,
        };
        if next == r {
            for c in (0..n).map(|i| r * x + from + ordered(n, i)) {
                let next = c.wrapping_add_signed(stride);
                sums[c] = sums[next] + f64::from(density[next]);
            }
            continue;
        }
        let (before, after) = sums.split_at_mut(r.max(next) * x);
        let (row, beyond) = match next > r {
            true => (&mut before[r * x..(r + 1) * x], &after[..x]),
            false => (&mut after[..x], &before[next * x..(next + 1) * x]),
        };
        let shifted = from.wrapping_add_signed(by[0]);
        let beyond = beyond[shifted..shifted + n].iter().zip(&density[next * x + shifted..]);
        for (sum, (beyond, density)) in row[from..from + n].iter_mut().zip(beyond) {
            *sum = beyond + f64::from(*density);
        }
    }
    sums
}

/// Steps to 13 neighbours; the other 13 are in the opposite directions.
fn steps(spacing: [f64; 3]) -> Vec<RayStep> {
    let mut steps = Vec::with_capacity(13);
    for code in 0..13 {
        let by = [code % 3 - 1, code / 3 % 3 - 1, code / 9 - 1];
        let length = (0..3).map(|k| (by[k] as f64 * spacing[k]).powi(2)).sum::<f64>().sqrt();
        steps.push(RayStep { by, length });
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_those_of_the_rays() {
        let dims = [5, 4, 3];
        let density: Vec<f32> = (0..60).map(|i| ((i * 37) % 11) as f32).collect();
        let at = |[i, j, k]: [isize; 3]| {
            let inside = [i, j, k].iter().zip(dims).all(|(v, d)| (0..d as isize).contains(v));
            inside.then(|| f64::from(density[((k * 4 + j) * 5 + i) as usize]))
        };
        for code in (0..27).filter(|code| *code != 13) {
            let by = [code % 3 - 1, code / 3 % 3 - 1, code / 9 - 1];
            let sums = sums_beyond(&density, dims, by);
            for (c, sum) in sums.iter().enumerate() {
                let from = [c % 5, c / 5 % 4, c / 20].map(|v| v as isize);
                let ray = (1..).map_while(|n| at(std::array::from_fn(|a| from[a] + n * by[a])));
                assert_eq!(ray.sum::<f64>(), *sum, "{by:?} from {from:?}");
            }
        }
    }
}
