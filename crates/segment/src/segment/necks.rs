//! Splits a body at its necks, such as touching beads of one colour, so that a click on one of them selects only that
//! one.
//!
//! The Gaussians are drawn into a grid of cells, what they enclose is filled, and each cell gets its depth, the
//! distance to the outside. Depth peaks where the body is thick; on the way to the next peak it falls to the radius of
//! the neck between them. Two peaks are two parts if the neck is thin relative to the thinner of them: the watershed of
//! the distance transform, which separates touching particles in images (Beucher and Lantuéjoul, *Use of watersheds in
//! contour detection*, 1979). As there, it suits round objects: a plume or a ring has necks too but is one object, so a
//! body is split only if each of its parts is round.

use super::depth::depths;
use super::place::density::solid;
use super::place::{Cloud, PlaceError};
use crate::config::types::segment::NecksConfig;
use crate::model::HostGaussians;
use crate::points::flood::{DensityPeak, flood};
use crate::points::neighbours::NeighbourGrid;
use crate::volume::grid::Grid;
use rayon::prelude::*;
use std::f64::consts::PI;

/// Cells of border around it.
const BORDER: usize = 4;

/// Returns the part of each Gaussian of `body`, a single connected piece, `[M]` from 1; all 1 where there is no neck or
/// a part is not round. Gaussians in no part of their own, on the surface layer or on bumps, join the nearest one.
///
/// # Errors
/// If the arrays of `body` disagree.
pub fn parts(body: &HostGaussians, config: &NecksConfig) -> Result<Vec<u32>, PlaceError> {
    let one = vec![1; body.len()];
    let grid = if config.separate { grid(body, config.cells) } else { None };
    let Some(grid) = grid else { return Ok(one) };
    let [x, y, _] = grid.dims;
    let opacity = body.opacity();
    let inside = |c: usize| {
        let place = [c % x, c / x % y, c / (x * y)];
        place.iter().zip(grid.dims).all(|(p, d)| *p > 0 && p + 1 < d)
    };
    let mut solid = solid(&Cloud::new(body, &opacity, &one), &grid, config.solid)?;
    solid.iter_mut().enumerate().for_each(|(c, solid)| *solid &= inside(c));
    let depth = depths(&solid, grid.dims);
    let mut order: Vec<usize> = (0..depth.len()).filter(|&c| depth[c] > 0.0).collect();
    order.par_sort_by(|&a, &b| depth[b].total_cmp(&depth[a]).then(a.cmp(&b)));
    let around = |c: usize, near: &mut Vec<usize>| {
        // cells with depth do not lie in the border
        for k in [c - x * y, c, c + x * y] {
            near.extend([k - x, k, k + x].into_iter().flat_map(|j| j - 1..=j + 1));
        }
    };
    let large = |low: f32, top: f32| low >= config.min_depth && low >= config.min_relative_depth * top;
    let parted = |low: &DensityPeak, top: &DensityPeak, c: usize| {
        let (low, top) = (depth[low.summit], depth[top.summit]);
        large(low, top) && depth[c] < config.neck * low
    };
    let (of_cell, modes) = flood(&order, depth.len(), |_| 1.0, around, parted);
    let of_cell = upwards(&order, of_cell, around);
    let highest = modes.first().map_or(0.0, |h| depth[h.summit]);
    let kept: Vec<bool> = modes.iter().map(|h| large(depth[h.summit], highest)).collect();
    let mut cells = vec![0usize; modes.len()];
    of_cell.iter().filter(|h| **h != usize::MAX).for_each(|h| cells[*h] += 1);
    let round = |n: usize| {
        let ball = 4.0 / 3.0 * PI * f64::from(depth[modes[n].summit]).powi(3);
        ball >= config.min_roundness * cells[n] as f64
    };
    let of_parts: Vec<usize> = (0..modes.len()).filter(|&n| kept[n]).collect();
    if of_parts.len() < 2 || !of_parts.into_iter().all(round) {
        return Ok(one);
    }
    let own = |i: usize| {
        let place: [f64; 3] = std::array::from_fn(|a| f64::from(body.means[3 * i + a]));
        let cell: [usize; 3] =
            std::array::from_fn(|a| ((place[a] - grid.origin[a]) / grid.spacing[a]).round().max(0.0) as usize);
        let within = cell.iter().zip(grid.dims).all(|(c, d)| *c < d);
        let mode = if within { of_cell[cell[0] + x * (cell[1] + y * cell[2])] } else { usize::MAX };
        if kept.get(mode).copied().unwrap_or(false) { mode as u32 + 1 } else { 0 }
    };
    Ok(joined(body, &(0..body.len()).map(own).collect::<Vec<u32>>()))
}

/// Assigns each cell to the peak that the steepest ascent from it leads to; [`flood`] gives a cell between two peaks to
/// the higher one, and gradually everything below the pass with it. `of_cell` is right for the summits.
fn upwards(order: &[usize], of_cell: Vec<usize>, around: impl Fn(usize, &mut Vec<usize>)) -> Vec<usize> {
    let mut place = vec![u32::MAX; of_cell.len()];
    order.iter().zip(0u32..).for_each(|(&c, n)| place[c] = n);
    let mut out = of_cell;
    let mut near = Vec::new();
    for &c in order {
        near.clear();
        around(c, &mut near);
        let highest = near.iter().copied().min_by_key(|&n| place[n]).filter(|&n| place[n] < place[c]);
        if let Some(above) = highest {
            out[c] = out[above];
        }
    }
    out
}

/// Assigns Gaussians without a part to that of the nearest one that has one.
fn joined(body: &HostGaussians, own: &[u32]) -> Vec<u32> {
    let place = |i: usize| [0, 1, 2].map(|a| body.means[3 * i + a]);
    let known: Vec<f32> =
        own.iter().enumerate().flat_map(|(i, l)| if *l > 0 { place(i) } else { [f32::NAN; 3] }).collect();
    // rows of three by construction
    let Ok(near) = NeighbourGrid::adaptive(&known) else { return own.to_vec() };
    let nearest = |i: usize| near.nearest(place(i), 1, None).first().map_or(1, |(j, _)| own[*j as usize]);
    (0..own.len()).into_par_iter().map(|i| if own[i] > 0 { own[i] } else { nearest(i) }).collect()
}

/// Cubic cells around the body, `cells` along its longest side; `None` if it has no finite position or no size.
fn grid(body: &HostGaussians, cells: usize) -> Option<Grid> {
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for place in body.means.chunks_exact(3).filter(|p| p.iter().all(|v| v.is_finite())) {
        for a in 0..3 {
            low[a] = low[a].min(f64::from(place[a]));
            high[a] = high[a].max(f64::from(place[a]));
        }
    }
    let side = (0..3).map(|a| high[a] - low[a]).fold(f64::NEG_INFINITY, f64::max);
    let cell = side / cells as f64;
    (cell.is_finite() && cell > 0.0).then(|| {
        let dims = std::array::from_fn(|a| ((high[a] - low[a]) / cell).ceil() as usize + 1 + 2 * BORDER);
        Grid::aligned(dims, [cell; 3], low.map(|v| v - BORDER as f64 * cell))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::test_support::{add, surfaces};

    #[test]
    fn beads_that_touch_are_parts_whatever_their_size_and_number() {
        for balls in [
            vec![(-0.9, 1.0), (0.9, 1.0)],
            vec![(-1.0, 1.0), (0.62, 0.7)],
            vec![(-3.6, 1.0), (-1.8, 1.0), (0.0, 1.0), (1.8, 1.0)],
        ] {
            let (body, of) = surfaces(&balls);
            let found = parts(&body, &NecksConfig::default()).unwrap();
            let mut wrong = 0;
            for (ball, _) in balls.iter().enumerate() {
                let labels: Vec<u32> = found.iter().zip(&of).filter(|(_, b)| **b == ball).map(|(l, _)| *l).collect();
                let most = (1..9).max_by_key(|l| labels.iter().filter(|m| *m == l).count()).unwrap();
                wrong += labels.iter().filter(|l| **l != most).count();
            }
            assert_eq!(found.iter().collect::<std::collections::BTreeSet<_>>().len(), balls.len());
            assert!(wrong * 25 < of.len(), "{wrong} of {} in {balls:?}", of.len());
        }
    }

    #[test]
    fn a_ball_two_merged_balls_and_a_rod_have_no_neck() {
        for balls in [vec![(0.0, 1.0)], vec![(-0.4, 1.0), (0.4, 1.0)], (0..20).map(|i| (0.1 * i as f32, 0.5)).collect()]
        {
            let (body, _) = surfaces(&balls);
            assert_eq!(parts(&body, &NecksConfig::default()).unwrap(), vec![1; body.len()], "{balls:?}");
        }
    }

    #[test]
    fn a_ring_with_two_necks_is_one_part() {
        // its halves are half circles
        let mut ring = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
        for k in 0..1200 {
            let along = k as f32 * std::f32::consts::TAU / 1200.0;
            let radius = 0.22 + 0.1 * (2.0 * along).cos();
            for around in (0..10).map(|a| (a as f32 + 0.5 * (k % 2) as f32) * std::f32::consts::TAU / 10.0) {
                let out = 1.5 + radius * around.cos();
                add(&mut ring, [out * along.cos(), out * along.sin(), radius * around.sin()], [-3.2; 3]);
            }
        }
        assert_eq!(parts(&ring, &NecksConfig::default()).unwrap(), vec![1; ring.len()]);
    }

    #[test]
    fn bodies_without_position_or_size_are_one_part() {
        let (mut body, _) = surfaces(&[(-0.9, 1.0), (0.9, 1.0)]);
        body.means[0] = f32::NAN;
        body.log_scales[6] = f32::INFINITY;
        assert!(parts(&body, &NecksConfig::default()).unwrap().iter().all(|l| *l > 0));
        let point = body.subset(&[7]);
        assert_eq!(parts(&point, &NecksConfig::default()).unwrap(), [1]);
        assert_eq!(parts(&body.subset(&[]), &NecksConfig::default()).unwrap(), [0u32; 0]);
    }
}
