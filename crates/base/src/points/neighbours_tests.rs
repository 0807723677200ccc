//! Tests of the neighbour grid against brute force.

use super::*;
use proptest::prelude::*;
use volseggs_testing::generator;

fn cloud(count: usize, seed: u64, outliers: bool) -> Vec<f32> {
    let mut u = generator(seed);
    let mut points: Vec<f32> = (0..3 * count).map(|_| u() * 2.0 - 1.0).collect();
    if outliers {
        points[..3].copy_from_slice(&[1e4, -3.0, 7.0]);
        points[3..6].copy_from_slice(&[f32::NAN, 0.0, 0.0]);
        points[6..9].copy_from_slice(&[0.0, f32::NEG_INFINITY, 0.0]);
    }
    points
}

fn brute(points: &[f32], query: [f32; 3], skip: Option<u32>) -> Vec<(u32, f32)> {
    let mut all: Vec<(u32, f32)> = (0..points.len() / 3)
        .filter(|&i| finite(point(points, i)) && Some(i as u32) != skip)
        .map(|i| (i as u32, squared(query, point(points, i))))
        .collect();
    all.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
    all
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn visits_and_nearest_agree_with_brute_force(
        seed in 0u64..1000, count in 3usize..200, cell in 0.01f32..3.0, radius in 0f32..2.0, k in 1usize..12,
    ) {
        let points = cloud(count, seed, seed % 2 == 0);
        let query = [points[points.len() - 3] + 0.01, 0.3, -0.2];
        for grid in [NeighbourGrid::new(&points, cell).unwrap(), NeighbourGrid::adaptive(&points).unwrap()] {
            let mut seen = Vec::new();
            grid.visit(query, radius, |id, d| { seen.push((id, d)); true });
            seen.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
            let all = brute(&points, query, None);
            let want: Vec<_> = all.iter().copied().filter(|n| n.1 <= radius * radius).collect();
            prop_assert_eq!(&seen, &want);
            let near = grid.nearest(query, k, None);
            prop_assert_eq!(&near[..], &all[..k.min(all.len())]);
            for (i, row) in (0u32..).zip(grid.nearest_of_each(4).rows()) {
                let place = point(&points, i as usize);
                let mut want: Vec<u32> = brute(&points, place, Some(i)).into_iter().take(4).map(|n| n.0).collect();
                want.resize(4, i);
                prop_assert_eq!(row.to_vec(), if finite(place) { want } else { vec![i; 4] });
            }
        }
    }

    #[test]
    fn counts_do_not_move_with_the_points(seed in 0u64..1000, shift in -8i32..8) {
        // coordinates on a binary lattice, so that rounding changes no distance after a shift
        let points: Vec<f32> = cloud(150, seed, false).iter().map(|v| (v * 64.0).round() / 64.0).collect();
        let moved: Vec<f32> = points.iter().map(|v| v + shift as f32).collect();
        let count = |p: &[f32]| NeighbourGrid::new(p, 0.3).unwrap().count_within(0.3, u32::MAX);
        prop_assert_eq!(count(&points), count(&moved));
    }
}

#[test]
fn counts_exclude_the_point_itself_and_stop_at_the_cap() {
    let grid = NeighbourGrid::new(&[0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0, f32::NAN, 0.0, 0.0], 0.5).unwrap();
    assert_eq!(grid.count_within(0.5, 99), [1, 2, 1, 0]);
    assert_eq!(grid.count_within(0.5, 1), [1, 1, 1, 0]);
    assert_eq!(&grid.nearest_distances()[..3], [0.5; 3]);
    assert!(grid.nearest_distances()[3].is_nan());
}

#[test]
fn a_point_far_away_does_not_leave_all_others_in_one_cell() {
    let mut points = cloud(2000, 3, false);
    points.extend([0.0, 3e7, 0.0]);
    let grid = NeighbourGrid::adaptive(&points).unwrap();
    assert!(grid.cells() > 200 && !grid.clamped(), "{} cells", grid.cells());
    assert_eq!(grid.nearest([0.0, 2e7, 0.0], 1, None)[0].0, 2000);
}

#[test]
fn equal_points_are_neighbours_at_distance_zero() {
    let grid = NeighbourGrid::adaptive(&[0.25; 30]).unwrap();
    assert_eq!(grid.count_within(0.0, 99), [9; 10]);
    assert_eq!(grid.nearest_distances(), [0.0; 10]);
    assert_eq!(grid.nearest([0.25; 3], 3, Some(0)), [(1, 0.0), (2, 0.0), (3, 0.0)]);
}

#[test]
fn extents_beyond_the_cells_are_still_right() {
    let points = [0.0, 0.0, 0.0, 1e30, 0.0, 0.0, 1e30, 1.0, 0.0, 0.001, 0.0, 0.0];
    let grid = NeighbourGrid::new(&points, 0.01).unwrap();
    assert!(grid.clamped());
    assert_eq!(grid.count_within(0.01, 9), [1, 0, 0, 1]);
    assert_eq!(grid.nearest([0.0; 3], 2, Some(0))[0], (3, 0.001f32 * 0.001));
}

#[test]
fn empty_single_and_wrong_input() {
    let empty = NeighbourGrid::adaptive(&[]).unwrap();
    assert!(empty.is_empty() && empty.nearest([0.0; 3], 3, None).is_empty());
    let one = NeighbourGrid::new(&[1.0, 2.0, 3.0], 0.1).unwrap();
    assert_eq!((one.len(), one.nearest([0.0; 3], 3, None).len(), one.nearest([1.0; 3], 3, Some(0)).len()), (1, 1, 0));
    assert!(one.nearest([f32::NAN; 3], 1, None).is_empty());
    assert!(NeighbourGrid::new(&[0.0; 4], 0.1).is_err());
    for cell in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        assert!(NeighbourGrid::new(&[0.0; 3], cell).is_err());
    }
}

#[test]
fn the_thread_count_never_changes_a_bit() {
    let points = cloud(20_000, 3, true);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let grid = NeighbourGrid::adaptive(&points).unwrap();
            let bits: Vec<u32> = grid.nearest_distances().iter().map(|d| d.to_bits()).collect();
            (bits, grid.count_within(0.1, 50), grid.nearest([0.0; 3], 20, None))
        })
    };
    assert_eq!(run(1), run(4));
}
