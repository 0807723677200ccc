//! The density of Gaussians on the cells that they reach.

use super::Cloud;
use super::bell::{Bell, BellProfile};
use crate::volume::grid::Grid;
use rayon::prelude::*;

/// Slices of z per task. Tasks have a fixed size and sums a fixed order, so the result does not depend on the number of
/// threads.
const SLAB: usize = 4;

/// The density on a box of cells of a grid.
#[derive(Debug, Default)]
pub struct Density {
    /// First cell of the box along x, y, z.
    pub first: [usize; 3],
    /// Cells of the box along x, y, z.
    pub dims: [usize; 3],
    /// The density there, `[z, y, x]`.
    pub values: Vec<f32>,
}

impl Density {
    /// Adds up `bells`, in their order, on the cells that they reach.
    pub fn new(bells: &[Bell], profile: BellProfile) -> Self {
        let (mut low, mut high) = ([u32::MAX; 3], [0; 3]);
        for bell in bells {
            for k in 0..3 {
                low[k] = low[k].min(bell.reach[k][0]);
                high[k] = high[k].max(bell.reach[k][1]);
            }
        }
        if bells.is_empty() {
            return Self::default();
        }
        let first = low.map(|v| v as usize);
        let dims: [usize; 3] = std::array::from_fn(|k| high[k] as usize + 1 - first[k]);
        let slabs = by_slab(bells, first[2], dims[2]);
        let mut values = vec![0.0f32; dims.iter().product()];
        values.par_chunks_mut(dims[0] * dims[1] * SLAB).zip(&slabs).enumerate().for_each(|(slab, (out, members))| {
            let from = first[2] + slab * SLAB;
            let to = from + out.len() / (dims[0] * dims[1]) - 1;
            for &i in members {
                let bell = &bells[i as usize];
                let [[y0, y1], [z0, z1]] = [bell.reach[1], bell.reach[2]].map(|r| r.map(|v| v as usize));
                for z in z0.max(from)..=z1.min(to) {
                    for y in y0..=y1 {
                        let row = ((z - from) * dims[1] + y - first[1]) * dims[0];
                        bell.add_row(profile, y, z, first[0], &mut out[row..row + dims[0]]);
                    }
                }
            }
        });
        Self { first, dims, values }
    }

    /// Calls `each` for every slice of z of the box, on all threads, with its cells: their values and their rows in
    /// the matching slice of `grid`-sized `out`.
    pub fn rows<T: Send>(&self, grid: [usize; 3], out: &mut [T], each: impl Fn(&[f32], &mut [T]) + Sync) {
        if self.values.is_empty() {
            return;
        }
        let ([x, y, _], [dx, dy, dz]) = (grid, self.dims);
        let slices = out.par_chunks_mut(x * y).skip(self.first[2]).take(dz);
        slices.zip(self.values.par_chunks(dx * dy)).for_each(|(out, values)| {
            for (j, values) in values.chunks_exact(dx).enumerate() {
                let row = (self.first[1] + j) * x + self.first[0];
                each(values, &mut out[row..row + dx]);
            }
        });
    }
}

/// The extinction density of `bells` at all cells of a grid, `[z, y, x]`, by [`BellProfile::Content`].
pub fn content(bells: &[Bell], dims: [usize; 3]) -> Vec<f32> {
    let mut out = vec![0.0; dims.iter().product()];
    Density::new(bells, BellProfile::Content).rows(dims, &mut out, |values, out| out.copy_from_slice(values));
    out
}

/// For each slab of z of a box that begins at `first` the bells that reach it, in their order.
fn by_slab(bells: &[Bell], first: usize, depth: usize) -> Vec<Vec<u32>> {
    let mut slabs = vec![Vec::new(); depth.div_ceil(SLAB)];
    for (bell, i) in bells.iter().zip(0u32..) {
        let [low, high] = bell.reach[2].map(|v| v as usize - first);
        for members in &mut slabs[low / SLAB..=high / SLAB] {
            members.push(i);
        }
    }
    slabs
}

/// Returns the Gaussians that are somewhere on the grid, by label and then by index.
pub fn bells(cloud: &Cloud<'_>, grid: &Grid, smallest: f64) -> Vec<Bell> {
    let all = (0..cloud.labels.len()).into_par_iter();
    let mut bells: Vec<Bell> = all.filter_map(|i| Bell::new(cloud, i, grid, smallest)).collect();
    bells.sort_by_key(|bell| bell.label);
    bells
}

/// Returns the cells where the opacities of all Gaussians of `cloud`, each times its bell curve, add up to more than
/// `threshold`, `[z, y, x]`; a Gaussian has standard deviations of at least half of the smallest spacing. It is a test
/// of shape alone, for [`necks`](crate::segment::necks); where a segment is, [`super::SegmentPlaces`] says.
///
/// # Errors
/// If arrays of `cloud` disagree, or the grid is impossible.
pub fn solid(cloud: &Cloud<'_>, grid: &Grid, threshold: f32) -> Result<Vec<bool>, super::PlaceError> {
    let mut solid = vec![false; super::check(cloud, grid)?];
    let density = Density::new(&bells(cloud, grid, super::smallest(grid)), BellProfile::Opacity);
    density.rows(grid.dims, &mut solid, |values, out| {
        values.iter().zip(out).for_each(|(value, out)| *out = *value > threshold);
    });
    Ok(solid)
}
