//! The volume a set of Gaussians fills: cells of a world-aligned grid inside the union of their ellipsoids. Which
//! Gaussians count is the caller's choice (see `statistics`).

use super::eigen::Matrix;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Cells of the grid at most (32 MiB of bits); a finer request is coarsened.
const MOST_CELLS: f64 = (1u64 << 28) as f64;

/// One ellipsoid: centre, rotation (columns are the axes), half axes, all in world units.
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
    /// Half sides of the axis-aligned box around it.
    pub fn half_sides(&self) -> [f64; 3] {
        [0, 1, 2].map(|i| (0..3).map(|k| (self.rotation[i][k] * self.half_axes[k]).powi(2)).sum::<f64>().sqrt())
    }
}

/// Volume of the union of `ellipsoids` in cubic world units, and the cell side used.
///
/// A cell of the grid (side `cell`, borders at multiples of it, the same at all times) counts if its centre is inside an
/// ellipsoid or an ellipsoid's centre is inside the cell. So a sheet thinner than a cell counts about one cell thick:
/// compare volumes of the same cell side alone. A grid of more than 2^28 cells is coarsened by doubling the side.
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
    while counts(cell).iter().product::<f64>() > MOST_CELLS {
        cell *= 2.0;
    }
    let first = low.map(|v| (v / cell).floor());
    let size = counts(cell).map(|n| n as usize);
    let bits: Vec<AtomicU64> = (0..(size[0] * size[1] * size[2]).div_ceil(64)).map(|_| AtomicU64::new(0)).collect();
    let set = |at: [usize; 3]| {
        let bit = (at[2] * size[1] + at[1]) * size[0] + at[0];
        bits[bit / 64].fetch_or(1 << (bit % 64), Ordering::Relaxed);
    };
    ellipsoids.par_iter().for_each(|e| {
        let index = |v: f64, a: usize| ((v / cell).floor() - first[a]).clamp(0.0, (size[a] - 1) as f64) as usize;
        set([0, 1, 2].map(|a| index(e.centre[a], a)));
        let half = e.half_sides();
        let from = [0, 1, 2].map(|a| index(e.centre[a] - half[a], a));
        let to = [0, 1, 2].map(|a| index(e.centre[a] + half[a], a));
        for z in from[2]..=to[2] {
            for y in from[1]..=to[1] {
                for x in from[0]..=to[0] {
                    let at = [x, y, z];
                    let d = [0, 1, 2].map(|a| (first[a] + at[a] as f64 + 0.5) * cell - e.centre[a]);
                    let inside: f64 = (0..3)
                        .map(|k| {
                            let along = (0..3).map(|i| e.rotation[i][k] * d[i]).sum::<f64>();
                            (along / e.half_axes[k]).powi(2)
                        })
                        .sum();
                    if inside <= 1.0 {
                        set(at);
                    }
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
    fn overlap_counts_once_and_distance_adds() {
        let one = ball([0.1; 3], [0.2; 3], [1.0, 0.0, 0.0, 0.0]);
        let far = Ellipsoid { centre: [3.1, 0.1, 0.1], ..one };
        let single = union_volume(&[one], 0.02).0;
        assert_eq!(union_volume(&[one, one], 0.02).0, single);
        assert!((union_volume(&[one, far], 0.02).0 / single - 2.0).abs() < 0.02);
    }

    #[test]
    fn poison_sizes() {
        assert_eq!(union_volume(&[], 0.1), (0.0, 0.1));
        let tiny = ball([0.55; 3], [1e-9; 3], [1.0, 0.0, 0.0, 0.0]);
        assert!((union_volume(&[tiny], 0.1).0 - 0.001).abs() < 1e-12);
        let apart = Ellipsoid { centre: [1e6; 3], ..tiny };
        assert!(union_volume(&[tiny, apart], 0.1).1 > 0.1);
    }
}
