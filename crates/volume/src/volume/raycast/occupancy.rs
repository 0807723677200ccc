//! Which bricks of a volume have something to show, and how far from each brick the nearest such one is.

use rayon::prelude::*;

/// Cells of a brick along each axis.
pub(super) const BRICK: usize = 4;

/// For each brick, the Chebyshev distance to the nearest occupied one, in bricks (0 is occupied).
#[derive(Debug)]
pub(super) struct BrickDistances {
    dims: [usize; 3],
    distance: Vec<u8>,
}

impl BrickDistances {
    /// `occupied` returns whether the brick that starts at a cell has something to show.
    pub fn new(voxels: [usize; 3], occupied: impl Fn([usize; 3]) -> bool + Sync) -> Self {
        let dims = voxels.map(|n| (n - 1).div_ceil(BRICK).max(1) + 1);
        let [bx, by, _] = dims;
        let mut distance = vec![u8::MAX; dims.iter().product()];
        distance.par_chunks_exact_mut(bx * by).enumerate().for_each(|(z, slice)| {
            for (i, d) in slice.iter_mut().enumerate() {
                let from = [i % bx * BRICK, i / bx * BRICK, z * BRICK];
                // the last brick of an axis holds only the voxels at its very end
                if (0..3).all(|a| from[a] < voxels[a]) && occupied(from) {
                    *d = 0;
                }
            }
        });
        let mut result = Self { dims, distance };
        result.spread();
        result
    }

    /// Number of occupied bricks.
    #[cfg(test)]
    pub fn occupied(&self) -> usize {
        self.distance.iter().filter(|d| **d == 0).count()
    }

    /// Computes the Chebyshev distances, exactly, in one sweep forward and one backward.
    fn spread(&mut self) {
        let [bx, by, bz] = self.dims;
        let at = |x: usize, y: usize, z: usize| (z * by + y) * bx + x;
        for backward in [false, true] {
            let turn = |i: usize, n: usize| if backward { n - 1 - i } else { i };
            for z in (0..bz).map(|i| turn(i, bz)) {
                for y in (0..by).map(|i| turn(i, by)) {
                    for x in (0..bx).map(|i| turn(i, bx)) {
                        let mut best = self.distance[at(x, y, z)];
                        if best == 0 {
                            continue;
                        }
                        // of the 27 places around, in order of z, y, x, the sweep has been at those before the middle
                        for n in 0..13isize {
                            let n = [n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1];
                            let sign = if backward { -1 } else { 1 };
                            let shifted = |i: usize, d: isize| i.checked_add_signed(sign * d);
                            if let (Some(x), Some(y), Some(z)) = (shifted(x, n[0]), shifted(y, n[1]), shifted(z, n[2]))
                                && x < bx
                                && y < by
                                && z < bz
                            {
                                best = best.min(self.distance[at(x, y, z)].saturating_add(1));
                            }
                        }
                        self.distance[at(x, y, z)] = best;
                    }
                }
            }
        }
    }

    /// The first step from `k` on that may show something; step k runs from `entry + k * delta`, which is `start`, to
    /// `entry + (k + 1) * delta` (voxel coordinates).
    ///
    /// A step with both ends in empty bricks is empty, as neighbouring bricks share the values between them.
    #[inline(always)]
    pub fn next(&self, k: u32, start: [f32; 3], entry: [f32; 3], inverse: [f32; 3]) -> u32 {
        let b: [usize; 3] = std::array::from_fn(|a| start[a] as usize / BRICK);
        let d = self.distance[(b[2] * self.dims[1] + b[1]) * self.dims[0] + b[0]];
        if d == 0 {
            return k;
        }
        // nothing within d - 1 bricks: advance to the step that leaves their box
        let d = i32::from(d);
        let mut leave = f32::INFINITY;
        for a in 0..3 {
            let side = if inverse[a] > 0.0 { b[a] as i32 + d } else { b[a] as i32 - d + 1 };
            leave = leave.min(((side * BRICK as i32) as f32 - entry[a]) * inverse[a]);
        }
        // slightly early, so that rounding never skips a step that counts
        k.max((leave - 0.01).max(0.0) as u32)
    }
}
