//! The volume that a set of Gaussians fills: cells of a world-aligned grid inside the union of their ellipsoids. The
//! caller chooses which Gaussians count (see `statistics`).

use super::eigen::Matrix;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Maximum number of grid cells (32 MiB of bits); a finer request is coarsened.
const MAX_CELLS: f64 = (1u64 << 28) as f64;

/// One ellipsoid: centre, rotation (columns are the axes), half axes, all in scene units.
#[derive(Debug, Clone, Copy)]
pub struct Ellipsoid {
    /// Centre.
    pub centre: [f64; 3],
    /// Rotation whose columns are the axes.
    pub rotation: Matrix,
    /// Half axes, positive.
    pub half_axes: [f64; 3],
}

impl Ellipsoid {
    /// Returns the half sides of its axis-aligned bounding box.
    pub fn half_sides(&self) -> [f64; 3] {
        [0, 1, 2].map(|i| (0..3).map(|k| (self.rotation[i][k] * self.half_axes[k]).powi(2)).sum::<f64>().sqrt())
    }
}

/// Returns the volume of the union of `ellipsoids` in cubic scene units, and the cell side used.
///
/// A cell of the grid (side `cell`, borders at multiples of it, the same at all times) counts if its centre is inside
/// an ellipsoid or an ellipsoid's centre is inside the cell. A sheet thinner than a cell therefore counts as about one
/// cell thick: compare only volumes of the same cell side. A grid of more than 2^28 cells is coarsened by doubling the
/// side.
pub fn union_volume(ellipsoids: &[Ellipsoid], cell: f64) -> (f64, f64) {
    if ellipsoids.is_empty() {
        return (0.0, cell);
    }
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for e in ellipsoids {
        let half = e.half_sides();
        for a in 0..3 {
            low[a] = low[a].min(e.centre[a] - half[a]);
            high[a] = high[a].max(e.centre[a] + half[a]);
        }
    }
    let mut cell = cell;
    let counts = |cell: f64| [0, 1, 2].map(|a| (high[a] / cell).floor() - (low[a] / cell).floor() + 1.0);
    while counts(cell).iter().product::<f64>() > MAX_CELLS {
        cell *= 2.0;
    }
    let first = low.map(|v| (v / cell).floor());
    let size = counts(cell).map(|n| n as usize);
    let bits: Vec<AtomicU64> = (0..(size[0] * size[1] * size[2]).div_ceil(64)).map(|_| AtomicU64::new(0)).collect();
    // fills cells `from..=to` along x, one word of bits at a time
    let fill = |from: usize, to: usize, y: usize, z: usize| {
        let row = (z * size[1] + y) * size[0];
        let (from, to) = (row + from, row + to);
        for word in from / 64..=to / 64 {
            let low = if word == from / 64 { u64::MAX << (from % 64) } else { u64::MAX };
            let high = if word == to / 64 { u64::MAX >> (63 - to % 64) } else { u64::MAX };
            bits[word].fetch_or(low & high, Ordering::Relaxed);
        }
    };
    ellipsoids.par_iter().for_each(|e| {
        let index = |v: f64, a: usize| ((v / cell).floor() - first[a]).clamp(0.0, (size[a] - 1) as f64) as usize;
        let [x, y, z] = [0, 1, 2].map(|a| index(e.centre[a], a));
        fill(x, x, y, z);
        let half = e.half_sides();
        let from = [0, 1, 2].map(|a| index(e.centre[a] - half[a], a));
        let to = [0, 1, 2].map(|a| index(e.centre[a] + half[a], a));
        // along a row of cells, the squared distance in half axes is a parabola in x, and the inside lies between the
        // two places where it is 1
        let slope = [0, 1, 2].map(|k| e.rotation[0][k] / e.half_axes[k]);
        let square: f64 = slope.iter().map(|s| s * s).sum();
        let middle = |v: usize, a: usize| (first[a] + v as f64 + 0.5) * cell - e.centre[a];
        let begin = middle(0, 0);
        for z in from[2]..=to[2] {
            for y in from[1]..=to[1] {
                let (dy, dz) = (middle(y, 1), middle(z, 2));
                let rest = [0, 1, 2].map(|k| (e.rotation[1][k] * dy + e.rotation[2][k] * dz) / e.half_axes[k]);
                let mixed: f64 = (0..3).map(|k| slope[k] * rest[k]).sum();
                let constant: f64 = rest.iter().map(|r| r * r).sum();
                let root = (mixed * mixed - square * (constant - 1.0)).sqrt();
                // no intersection, or so thin that no cell's centre lies in it
                if !root.is_finite() || !square.is_finite() {
                    continue;
                }
                let at = |x: f64| (x - begin) / cell;
                let low = at((-mixed - root) / square).ceil().max(from[0] as f64);
                let high = at((-mixed + root) / square).floor().min(to[0] as f64);
                if low <= high {
                    fill(low as usize, high as usize, y, z);
                }
            }
        }
    });
    let filled: u64 = bits.iter().map(|b| u64::from(b.load(Ordering::Relaxed).count_ones())).sum();
    (filled as f64 * cell.powi(3), cell)
}

#[cfg(test)]
mod tests {
    use super::super::eigen::rotation;
    use super::*;

    fn ball(centre: [f64; 3], half_axes: [f64; 3], turn: [f32; 4]) -> Ellipsoid {
        Ellipsoid { centre, rotation: rotation(turn), half_axes }
    }

    #[test]
    fn an_ellipsoid_has_its_volume_however_turned_and_moved() {
        let exact = 4.0 / 3.0 * std::f64::consts::PI * 0.5 * 0.3 * 0.2;
        for turn in [[1.0, 0.0, 0.0, 0.0], [0.3, -0.5, 0.8, 0.1]] {
            for centre in [[0.0; 3], [10.3, -7.1, 0.77]] {
                let (volume, cell) = union_volume(&[ball(centre, [0.5, 0.3, 0.2], turn)], 0.01);
                assert!((volume / exact - 1.0).abs() < 0.01, "{volume} {exact}");
                assert_eq!(cell, 0.01);
            }
        }
    }

    #[test]
    fn a_cell_counts_by_its_centre() {
        let e = ball([0.31, -0.22, 0.17], [0.8, 0.05, 0.3], [0.3, -0.5, 0.8, 0.1]);
        let (cell, side) = (0.026f64, 100usize);
        let inside = |i: &usize| {
            let at = [i % side, i / side % side, i / side / side];
            let d = [0, 1, 2].map(|a| (at[a] as f64 - 50.0 + 0.5) * cell - e.centre[a]);
            let along = |k: usize| (0..3).map(|i| e.rotation[i][k] * d[i]).sum::<f64>() / e.half_axes[k];
            (0..3).map(|k| along(k).powi(2)).sum::<f64>() <= 1.0
        };
        let count = (0..side.pow(3)).filter(inside).count();
        assert_eq!((union_volume(&[e], cell).0 / cell.powi(3)).round(), count as f64);
    }

    #[test]
    fn overlap_counts_once_and_distance_adds() {
        let one = ball([0.1; 3], [0.2; 3], [1.0, 0.0, 0.0, 0.0]);
        let far = Ellipsoid { centre: [3.1, 0.1, 0.1], ..one };
        let single = union_volume(&[one], 0.02).0;
        assert_eq!(union_volume(&[one, one], 0.02).0, single);
        assert!((union_volume(&[one, far], 0.02).0 / single - 2.0).abs() < 0.02);
    }

    #[test]
    fn empty_tiny_and_far_apart_inputs() {
        assert_eq!(union_volume(&[], 0.1), (0.0, 0.1));
        let tiny = ball([0.55; 3], [1e-9; 3], [1.0, 0.0, 0.0, 0.0]);
        assert!((union_volume(&[tiny], 0.1).0 - 0.001).abs() < 1e-12);
        let apart = Ellipsoid { centre: [1e6; 3], ..tiny };
        assert!(union_volume(&[tiny, apart], 0.1).1 > 0.1);
    }
}
