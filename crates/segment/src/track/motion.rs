//! The velocity of a segment: how fast its centroid moves.
//!
//! Between times with training views the motion of Gaussians is only interpolated, piecewise, and at such a time a
//! centroid is off by a fraction of a voxel. So a velocity is not the difference of two neighbouring centroids but the
//! slope of a parabola that is fitted by least squares to the centroids of all times within a window around its time.
//! It is exact for constant acceleration.

use super::statistics::{RowStatus, SegmentStatistics};

/// Half width of the window in distances between times with training views: two before and two after.
const REACH: f64 = 2.0;

/// Returns half the width of the window, given the times with training views, any order: twice their mean distance; 0
/// if there are fewer than two, so that only neighbouring times count.
pub fn window(trained: &[f64]) -> f64 {
    let low = trained.iter().copied().fold(f64::INFINITY, f64::min);
    let high = trained.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if trained.len() < 2 { 0.0 } else { REACH * (high - low) / (trained.len() - 1) as f64 }
}

/// Fills in the velocities of one segment's statistics, given in order of time, forward or backward.
///
/// A velocity is the slope at its time of the parabola (of the line, if there are only two) fitted to the centroids of
/// the times at most `window` away, and at least of the nearest before and after. Times at which the segment is lost do
/// not count, and have no velocity; nor has a time without any other.
pub fn fill_velocities(series: &mut [SegmentStatistics], window: f64) {
    let knots: Vec<Option<(f64, [f64; 3])>> =
        series.iter().map(|s| Some((s.time, s.centroid.filter(|_| s.status != RowStatus::Lost)?))).collect();
    for (i, entry) in series.iter_mut().enumerate() {
        entry.velocity = knots[i].and_then(|(time, _)| {
            let near = |step: f64| step.abs() <= window * (1.0 + 1e-9);
            // beyond a lost time the segment may be another thing
            let side = |others: &mut dyn Iterator<Item = &Option<(f64, [f64; 3])>>| {
                let mut found: Vec<(f64, [f64; 3])> = Vec::new();
                for knot in others {
                    let Some((at, place)) = knot else { break };
                    let step = at - time;
                    if step == 0.0 || (!near(step) && !found.is_empty()) {
                        break;
                    }
                    found.push((step, *place));
                }
                found
            };
            let mut points = side(&mut knots[..i].iter().rev());
            points.extend(side(&mut knots[i + 1..].iter()));
            points.extend(knots[i].map(|(_, place)| (0.0, place)));
            slope(&points)
        });
    }
}

/// Returns the slope at 0 of the parabola, or the line if there are fewer than three, that fits `(x, y)` best; `None`
/// for fewer than two points.
fn slope(points: &[(f64, [f64; 3])]) -> Option<[f64; 3]> {
    let widest = points.iter().map(|(x, _)| x.abs()).fold(0.0, f64::max);
    let n = points.len() as f64;
    if points.len() < 2 || widest == 0.0 || !widest.is_finite() {
        return None;
    }
    // sums of powers of x / widest, of which the normal equations consist
    let sum = |power: i32| points.iter().map(|(x, _)| (x / widest).powi(power)).sum::<f64>();
    let [s1, s2, s3, s4] = [1, 2, 3, 4].map(sum);
    // orthogonal to constants: x and x^2 less their means
    let (xx, xq, qq) = (s2 - s1 * s1 / n, s3 - s1 * s2 / n, s4 - s2 * s2 / n);
    let determinant = xx * qq - xq * xq;
    let curved = points.len() > 2 && determinant > 1e-12 * xx * qq;
    Some(std::array::from_fn(|k| {
        let with = |power: i32| points.iter().map(|(x, y)| (x / widest).powi(power) * y[k]).sum::<f64>();
        let mean = with(0) / n;
        let (xy, qy) = (with(1) - s1 * mean, with(2) - s2 * mean);
        let slope = if curved { (qq * xy - xq * qy) / determinant } else { xy / xx };
        slope / widest
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(places: &[(f64, Option<f64>)]) -> Vec<SegmentStatistics> {
        let row = |&(time, x): &(f64, Option<f64>)| SegmentStatistics {
            time,
            centroid: x.map(|x| [x, 2.0 * x, 100.0]),
            ..SegmentStatistics::default()
        };
        places.iter().map(row).collect()
    }

    fn velocities(places: &[(f64, Option<f64>)], window: f64) -> Vec<Option<f64>> {
        let mut rows = series(places);
        fill_velocities(&mut rows, window);
        for v in rows.iter().filter_map(|r| r.velocity) {
            assert!((v[1] - 2.0 * v[0]).abs() < 1e-9 && v[2].abs() < 1e-9, "{v:?}");
        }
        rows.iter().map(|r| r.velocity.map(|v| v[0])).collect()
    }

    #[test]
    fn constant_acceleration_is_exact_for_any_times_and_window() {
        let times = [0.0, 0.1, 0.25, 0.3, 0.6, 0.7, 1.0];
        for backward in [false, true] {
            let mut places: Vec<(f64, Option<f64>)> = times.iter().map(|t| (*t, Some(3.0 - t + 4.0 * t * t))).collect();
            if backward {
                places.reverse();
            }
            for window in [0.0, 0.2, 0.5, 2.0] {
                let found = velocities(&places, window);
                let ends = [0, times.len() - 1];
                for (i, v) in found.iter().enumerate() {
                    // at an end with a single neighbour, only the line through both is known
                    if window >= 0.5 || !ends.contains(&i) {
                        let exact = -1.0 + 8.0 * places[i].0;
                        assert!((v.unwrap() - exact).abs() < 1e-6, "{window} {i} {v:?} {exact}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_jump_between_two_times_does_not_show_as_speed() {
        // steps of a constant motion, as linear knots give them
        let places: Vec<(f64, Option<f64>)> =
            (0..51).map(|i| (f64::from(i) / 50.0, Some((f64::from(i) / 50.0 * 7.0).round() / 7.0))).collect();
        let jumpy = velocities(&places, 0.0);
        assert!(jumpy.iter().flatten().any(|v| *v > 3.0) && jumpy.iter().flatten().any(|v| *v == 0.0));
        let smooth =
            velocities(&places, window(&[0.0, 1.0 / 7.0, 2.0 / 7.0, 3.0 / 7.0, 4.0 / 7.0, 5.0 / 7.0, 6.0 / 7.0, 1.0]));
        for v in &smooth[10..41] {
            assert!((v.unwrap() - 1.0).abs() < 0.15, "{v:?}");
        }
    }

    #[test]
    fn lost_times_have_no_velocity_and_part_what_is_before_from_what_is_after() {
        let places =
            [(0.0, Some(0.0)), (0.1, Some(1.0)), (0.2, None), (0.3, Some(50.0)), (0.4, Some(51.0)), (0.5, Some(52.0))];
        let found = velocities(&places, 1.0);
        assert!((found[1].unwrap() - 10.0).abs() < 1e-9 && (found[3].unwrap() - 10.0).abs() < 1e-9, "{found:?}");
        assert_eq!(found[2], None);
        let mut rows = series(&[(0.0, Some(0.0)), (0.5, Some(1.0)), (1.0, Some(2.0))]);
        rows[1].status = RowStatus::Lost;
        fill_velocities(&mut rows, 1.0);
        assert!(rows.iter().all(|r| r.velocity.is_none()), "each of the others is alone");
        assert_eq!(velocities(&[(0.3, Some(1.0))], 1.0), [None]);
        assert_eq!(velocities(&[], 1.0), []);
    }

    #[test]
    fn the_window_follows_the_distance_of_trained_times() {
        assert_eq!((window(&[]), window(&[0.5])), (0.0, 0.0));
        assert!((window(&[1.0, 0.0, 0.25, 0.5, 0.75]) - 0.5).abs() < 1e-12);
    }
}
