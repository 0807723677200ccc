//! A volume laid out for sampling: padded with its own border values, so that trilinear interpolation and its gradient
//! need no case distinction.

use crate::volume::grid::Volume;
use rayon::prelude::*;

/// Voxels added before the first along each axis; two more follow the last.
const BEFORE: usize = 1;
const PADDING: usize = 3;

/// A padded scalar field.
#[derive(Debug)]
pub(super) struct PaddedField {
    pub dims: [usize; 3],
    row: usize,
    slice: usize,
    values: Vec<f32>,
}

impl PaddedField {
    pub fn new(volume: &Volume) -> Self {
        let dims = volume.grid.dims;
        let [nx, ny, nz] = dims;
        let row = nx + PADDING;
        let slice = row * (ny + PADDING);
        let mut values = vec![0.0; slice * (nz + PADDING)];
        values.par_chunks_exact_mut(slice).enumerate().for_each(|(k, out)| {
            let z = k.saturating_sub(BEFORE).min(nz - 1);
            for (j, out) in out.chunks_exact_mut(row).enumerate() {
                let y = j.saturating_sub(BEFORE).min(ny - 1);
                let from = &volume.values[(z * ny + y) * nx..][..nx];
                out[BEFORE..BEFORE + nx].copy_from_slice(from);
                out[0] = from[0];
                out[BEFORE + nx..].fill(from[nx - 1]);
            }
        });
        Self { dims, row, slice, values }
    }

    /// Index of the padded corner `(x - 1, y - 1, z - 1)` of a cell, and the position in the cell.
    #[inline(always)]
    fn cell(&self, p: [f32; 3]) -> (usize, [f32; 3]) {
        let i = [p[0] as usize, p[1] as usize, p[2] as usize];
        (i[2] * self.slice + i[1] * self.row + i[0], [p[0] - i[0] as f32, p[1] - i[1] as f32, p[2] - i[2] as f32])
    }

    /// The values at `x - 1 .. x + 2` of row `(dy, dz)` of the cell's neighbourhood.
    #[inline(always)]
    fn quad(&self, corner: usize, dy: usize, dz: usize) -> [f32; 4] {
        let at = corner + dz * self.slice + dy * self.row;
        let v = &self.values[at..at + 4];
        [v[0], v[1], v[2], v[3]]
    }

    /// The trilinear value at voxel coordinates `p`, each in `[0, dims - 1]`.
    #[inline(always)]
    pub fn sample(&self, p: [f32; 3]) -> f32 {
        let (corner, f) = self.cell(p);
        let pair = |dy, dz| {
            let at = corner + 1 + dz * self.slice + dy * self.row;
            let v = &self.values[at..at + 2];
            lerp(v[0], v[1], f[0])
        };
        lerp(lerp(pair(1, 1), pair(2, 1), f[1]), lerp(pair(1, 2), pair(2, 2), f[1]), f[2])
    }

    /// Central differences of neighbouring voxels (not halved), interpolated at `p`: the gradient in data units per
    /// two voxels.
    #[inline(always)]
    pub fn gradient(&self, p: [f32; 3]) -> [f32; 3] {
        let (corner, f) = self.cell(p);
        let q = |dy, dz| self.quad(corner, dy, dz);
        // rows y = 0, 1 at z = 0, 1 are used by all three; the outer rows by y and z alone
        let (q11, q21, q12, q22) = (q(1, 1), q(2, 1), q(1, 2), q(2, 2));
        let middle = lerp4(lerp4(q11, q21, f[1]), lerp4(q12, q22, f[1]), f[2]);
        let gx = lerp(middle[2] - middle[0], middle[3] - middle[1], f[0]);
        let x = |v: [f32; 4]| lerp(v[1], v[2], f[0]);
        let along_y = |dz: usize, a: f32, b: f32| lerp(b - x(q(0, dz)), x(q(3, dz)) - a, f[1]);
        let (x11, x21, x12, x22) = (x(q11), x(q21), x(q12), x(q22));
        let gy = lerp(along_y(1, x11, x21), along_y(2, x12, x22), f[2]);
        let along_z = |dy: usize, a: f32, b: f32| lerp(b - x(q(dy, 0)), x(q(dy, 3)) - a, f[2]);
        let gz = lerp(along_z(1, x11, x12), along_z(2, x21, x22), f[1]);
        [gx, gy, gz]
    }

    /// Smallest and largest value at the corners of cells `from .. from + size` (clipped to the grid) on each axis.
    pub fn extremes(&self, from: [usize; 3], size: usize) -> (f32, f32) {
        let [nx, ny, nz] = self.dims;
        let end = |a: usize, n: usize| (a + size).min(n - 1);
        let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
        for z in from[2]..=end(from[2], nz) {
            for y in from[1]..=end(from[1], ny) {
                let start = (z + BEFORE) * self.slice + (y + BEFORE) * self.row + BEFORE;
                for v in &self.values[start + from[0]..=start + end(from[0], nx)] {
                    low = low.min(*v);
                    high = high.max(*v);
                }
            }
        }
        (low, high)
    }
}

#[inline(always)]
fn lerp(a: f32, b: f32, f: f32) -> f32 {
    a + (b - a) * f
}

#[inline(always)]
fn lerp4(a: [f32; 4], b: [f32; 4], f: f32) -> [f32; 4] {
    std::array::from_fn(|i| lerp(a[i], b[i], f))
}
