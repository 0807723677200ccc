//! Neighbours among moving points: those that stay near, rather than those that pass by.

use super::PointsError;
use super::chunks::{map_chunks, point};
use super::nearest_rows::NearestRows;
use super::neighbours::NeighbourGrid;

/// Returns, for each of M points, the indices of the `k` others that stay nearest to it, `[M, k]`. `times` holds the
/// points at each time, `[M, 3]`. Of those among a point's `k` nearest at any time, these are the ones with the smallest
/// sum of distances over all times, from near to far (smaller index first among equals); at a single time they are the
/// nearest. The point's own index fills missing places and, at a single time, the row of a point that is not finite;
/// one that is not finite at some of several times comes last.
///
/// # Errors
/// If the points of a time are not rows of three.
///
/// # Panics
/// If the times have different numbers of points.
pub fn nearest_over_time(times: &[&[f32]], k: usize) -> Result<NearestRows, PointsError> {
    let found = times.iter().map(|points| Ok(NeighbourGrid::adaptive(points)?.nearest_of_each(k)));
    let mut found: Vec<NearestRows> = found.collect::<Result<_, PointsError>>()?;
    let count = times.first().map_or(0, |points| points.len() / 3);
    assert!(times.iter().all(|points| points.len() == 3 * count), "times: the same number of points at each");
    if found.len() == 1 {
        return Ok(found.pop().unwrap_or_default());
    }
    let apart = |i: usize, other: u32| {
        let at_one = |points: &&[f32]| {
            let (a, b) = (point(points, i), point(points, other as usize));
            (0..3).map(|axis| (f64::from(a[axis]) - f64::from(b[axis])).powi(2)).sum::<f64>().sqrt()
        };
        let sum: f64 = times.iter().map(at_one).sum();
        if sum.is_nan() { f64::INFINITY } else { sum }
    };
    let row = |i: usize| {
        let mut met: Vec<u32> =
            found.iter().flat_map(|rows| rows.row(i)).copied().filter(|&other| other as usize != i).collect();
        met.sort_unstable();
        met.dedup();
        let mut met: Vec<(f64, u32)> = met.into_iter().map(|other| (apart(i, other), other)).collect();
        met.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let own = std::iter::repeat_n(i as u32, k);
        met.into_iter().map(|(_, other)| other).chain(own).take(k).collect::<Vec<u32>>()
    };
    Ok(NearestRows::new(k, map_chunks(count, |range| range.flat_map(&row).collect::<Vec<u32>>()).concat()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, Rng};

    fn cloud(count: usize, seed: u64) -> Vec<f32> {
        let mut rng = Rng::new(seed, 0, Purpose::Custom(0));
        (0..3 * count).map(|_| rng.normal()).collect()
    }

    #[test]
    fn at_one_time_the_nearest_and_of_unmoving_points_as_well() {
        let points = cloud(200, 1);
        let once = NeighbourGrid::adaptive(&points).unwrap().nearest_of_each(5);
        assert_eq!(nearest_over_time(&[&points], 5).unwrap(), once);
        assert_eq!(nearest_over_time(&[&points, &points, &points], 5).unwrap(), once);
        assert_eq!(nearest_over_time(&[], 5).unwrap().rows().count(), 0);
        assert_eq!(nearest_over_time(&[&[], &[]], 2).unwrap().rows().count(), 0);
    }

    #[test]
    fn what_passes_by_is_no_neighbour() {
        // two lines of points; the second crosses the first at the second of three times
        let line = |y: f32| (0..20).flat_map(|i| [0.1 * i as f32, y, 0.0]).collect::<Vec<f32>>();
        let times = [-2.0, 0.01, 2.0].map(|y| [line(0.0), line(y)].concat());
        let slices: Vec<&[f32]> = times.iter().map(Vec::as_slice).collect();
        let crossing = NeighbourGrid::adaptive(&times[1]).unwrap().nearest_of_each(3);
        assert!((0..20).all(|i| crossing.row(i)[0] as usize == i + 20), "what passes by is the nearest while it does");
        for (i, row) in nearest_over_time(&slices, 3).unwrap().rows().enumerate() {
            assert!(row.iter().all(|&k| (k < 20) == (i < 20)), "{i}: {row:?}");
        }
    }

    #[test]
    fn the_smallest_sums_of_distances_whatever_the_number_of_threads() {
        let start = cloud(60, 2);
        let moves = cloud(60, 3);
        let times = [0.0, 0.1, 0.2].map(|t| start.iter().zip(&moves).map(|(s, m)| s + t * m).collect::<Vec<f32>>());
        let slices: Vec<&[f32]> = times.iter().map(Vec::as_slice).collect();
        let found = nearest_over_time(&slices, 6).unwrap();
        let sum = |i: usize, k: usize| -> f64 {
            let square = |t: &Vec<f32>, a: usize| f64::from(t[3 * i + a] - t[3 * k + a]).powi(2);
            times.iter().map(|t| (0..3).map(|a| square(t, a)).sum::<f64>().sqrt()).sum()
        };
        for (i, row) in found.rows().enumerate() {
            let sums: Vec<f64> = row.iter().map(|&k| sum(i, k as usize)).collect();
            assert!(sums.is_sorted() && !row.contains(&(i as u32)), "{i}: {sums:?}");
            let nearest = (0..60).filter(|&k| k != i).map(|k| sum(i, k)).fold(f64::INFINITY, f64::min);
            assert!((sums[0] - nearest).abs() < 1e-5, "{i}: {} but {nearest}", sums[0]);
        }
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert_eq!(pool.install(|| nearest_over_time(&slices, 6).unwrap()), found);
    }

    #[test]
    fn points_that_are_not_finite_come_last() {
        let still = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0f32];
        let mut lost = still;
        lost[3] = f32::NAN;
        let rows =
            |times: &[&[f32]]| nearest_over_time(times, 2).unwrap().rows().map(<[u32]>::to_vec).collect::<Vec<_>>();
        assert_eq!(rows(&[&lost]), [[2, 0], [1, 1], [0, 2]]);
        assert_eq!(rows(&[&still, &lost]), [[2, 1], [0, 2], [0, 1]]);
        assert!(nearest_over_time(&[&still[..4]], 2).is_err());
    }
}
