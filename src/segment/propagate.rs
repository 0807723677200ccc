//! Propagates a selection made at one time to all others: Gaussians that are invisible at the time of a click and
//! appear at another belong to the object in which they appear.
//!
//! Training may learn a motion as fading: some Gaussians fade out where an object was, others fade in where it is. A
//! click then selects the Gaussians that the object consists of at that time, and none of those that it consists of
//! later. In between, both are visible and overlap: at each of many times, from that of the click outwards, Gaussians
//! that have appeared join the nearest ones that they overlap, whether these are selected or not. Gaussians that appear
//! on their own, as a new object does, join none.
//!
//! Fading is rarely complete: at the time of the click, what an object consists of at other times is left as scattered
//! faint [`strays`]. Unless selected, these are treated as invisible then.

use super::pieces::{SEEN, strays};
use crate::model::{HostGaussians, Scene};
use crate::points::PointsError;
use crate::points::chunks::point;
use crate::points::components::largest_scales;
use crate::points::neighbours::Grid;
use rayon::prelude::*;

/// Step between the times visited, about that between 15 training times.
const STEP: f64 = 1.0 / 15.0;
/// Distance up to which two Gaussians overlap, as a multiple of the sum of their largest standard deviations. Values
/// from 0.7 to 1.5 make no difference; at 2.5, Gaussians that appear beside an object join it too: see the results of
/// 2026-11-23 in `benches/results`.
const OVERLAP: f32 = 1.0;
/// Number of neighbours that vote.
const VOTERS: usize = 6;

/// Extends what was `selected` at `time` in [0, 1] among the Gaussians `within` to all times: adds those invisible at
/// that time, or [`strays`] then, that appear in it at another. Both lists and the result are ascending. Where
/// opacities do not change over time, the result is `selected`.
///
/// # Errors
/// If arrays of the scene disagree.
pub fn propagate(scene: &Scene, selected: &[u32], within: &[u32], time: f64) -> Result<Vec<u32>, PointsError> {
    if !scene.opacity_changes() || within.is_empty() {
        return Ok(selected.to_vec());
    }
    let some = scene.some(within);
    let was: Vec<bool> = within.iter().map(|i| selected.binary_search(i).is_ok()).collect();
    let is = propagated(&was, time, |t| some.at(t as f32))?;
    Ok(within.iter().zip(is).filter(|(_, is)| *is).map(|(i, _)| *i).collect())
}

/// The same for M Gaussians, given `at` any time: whether each belongs to what `was` selected, `[M]`.
fn propagated(was: &[bool], time: f64, at: impl Fn(f64) -> HostGaussians) -> Result<Vec<bool>, PointsError> {
    let seen = |at: &HostGaussians, i: usize| at.opacity_of(i) >= SEEN && at.is_finite(i);
    let first = at(time);
    let stray = strays(&first)?;
    let is_known = |i: usize| seen(&first, i) && (was[i] || !stray[i]);
    let mut known: Vec<Option<bool>> = (0..was.len()).map(|i| is_known(i).then_some(was[i])).collect();
    for time in outwards(time) {
        let at = at(time);
        let (there, open): (Vec<u32>, Vec<u32>) =
            (0..was.len() as u32).filter(|&i| seen(&at, i as usize)).partition(|&i| known[i as usize].is_some());
        for (i, is) in joining(&at, &there, &open, &known)? {
            known[i as usize] = Some(is);
        }
    }
    Ok(known.into_iter().zip(was).map(|(known, was)| known.unwrap_or(*was)).collect())
}

/// Returns the times from `time` to the end, then from `time` back to the beginning, without `time` itself.
fn outwards(time: f64) -> Vec<f64> {
    let steps = |to: f64| {
        let count = ((to - time).abs() / STEP).ceil() as usize;
        (1..=count).map(move |k| if k == count { to } else { time + (to - time).signum() * STEP * k as f64 })
    };
    steps(1.0).chain(steps(0.0)).collect()
}

/// Returns which of the `open` Gaussians overlap any of their nearest among those `there`, and whether most of the
/// opacity of the overlapped ones is `known` to be selected.
fn joining(
    at: &HostGaussians,
    there: &[u32],
    open: &[u32],
    known: &[Option<bool>],
) -> Result<Vec<(u32, bool)>, PointsError> {
    if there.is_empty() || open.is_empty() {
        return Ok(Vec::new());
    }
    let radii = largest_scales(&at.log_scales)?;
    let means: Vec<f32> = there.iter().flat_map(|&i| point(&at.means, i as usize)).collect();
    let grid = Grid::adaptive(&means)?;
    let vote = |&i: &u32| {
        let mut sums: Option<[f32; 2]> = None;
        for (n, square) in grid.nearest(point(&at.means, i as usize), VOTERS, None) {
            let voter = there[n as usize] as usize;
            let limit = OVERLAP * (radii[i as usize] + radii[voter]);
            if square <= limit * limit {
                sums.get_or_insert_default()[usize::from(known[voter] == Some(true))] += at.opacity_of(voter);
            }
        }
        sums.map(|[rest, selected]| (i, selected > rest))
    };
    Ok(open.par_iter().filter_map(vote).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::balls::{add, on_threads};

    const ALONG: usize = 12;
    const STAGES: usize = 8;

    /// Two rods side by side that rise by fading: each has a row of Gaussians at each of several heights, visible while
    /// the rod is near it. Rows of the first rod, then of the second, then one Gaussian that is never visible.
    fn rods(time: f64) -> HostGaussians {
        let mut out = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
        for (rod, stage) in (0..2).flat_map(|rod| (0..STAGES).map(move |s| (rod, s))) {
            let away = (time * (STAGES - 1) as f64 - stage as f64).abs();
            for k in 0..ALONG {
                add(&mut out, [0.1 * k as f32, 2.0 * rod as f32, 0.12 * stage as f32], [-2.7; 3]);
                *out.opacity_logits.last_mut().unwrap() = if away < 0.8 { 2.0 } else { -8.0 };
            }
        }
        add(&mut out, [0.0; 3], [-2.7; 3]);
        *out.opacity_logits.last_mut().unwrap() = -8.0;
        out
    }

    #[test]
    fn gaussians_that_replace_selected_ones_are_selected_and_others_are_not() {
        let n = 2 * STAGES * ALONG + 1;
        for time in [0.0, 0.5, 1.0] {
            let seen = rods(time).opacity();
            let first = |i: usize| i < STAGES * ALONG;
            let was: Vec<bool> = (0..n).map(|i| first(i) && seen[i] > 0.1).collect();
            let found = propagated(&was, time, rods).unwrap();
            assert_eq!(found, (0..n).map(first).collect::<Vec<_>>(), "{time}");
            assert_eq!(found, on_threads(1, || propagated(&was, time, rods)).unwrap());
        }
    }

    #[test]
    fn faint_remains_of_other_times_do_not_stay_behind() {
        // the first of each row never vanishes: where the rod is not, single faint Gaussians are visible
        let remains = |time: f64| {
            let mut at = rods(time);
            for row in 0..2 * STAGES {
                let away = (time * (STAGES - 1) as f64 - (row % STAGES) as f64).abs();
                if away > 3.4 {
                    at.opacity_logits[row * ALONG] = -3.5;
                }
            }
            at
        };
        let first = |i: usize| i < STAGES * ALONG;
        for time in [0.0, 0.5, 1.0] {
            let at = remains(time);
            let was: Vec<bool> = (0..at.len()).map(|i| first(i) && at.opacity_of(i) > 0.1).collect();
            assert!((0..at.len()).any(|i| first(i) && !was[i] && at.opacity_of(i) >= SEEN), "{time}: some are seen");
            assert_eq!(
                propagated(&was, time, remains).unwrap(),
                (0..at.len()).map(first).collect::<Vec<_>>(),
                "{time}"
            );
        }
    }

    #[test]
    fn invisible_gaussians_are_unchanged_and_non_finite_ones_join_nothing() {
        let n = 2 * STAGES * ALONG + 1;
        let mut was = vec![false; n];
        was[n - 1] = true;
        let poisoned = |t: f64| {
            let mut at = rods(t);
            at.means[3] = f32::NAN;
            at
        };
        assert_eq!(propagated(&was, 0.5, poisoned).unwrap(), was);
        assert_eq!(
            propagated(&[], 0.5, |_| HostGaussians { sh_stride: 1, ..HostGaussians::default() }).unwrap(),
            [false; 0]
        );
    }

    #[test]
    fn times_go_outwards_and_reach_both_ends() {
        let times = outwards(0.49);
        assert!(times.contains(&0.0) && times.contains(&1.0) && !times.contains(&0.49));
        assert_eq!((times.len(), outwards(1.0).len()), (16, 15));
        assert!((times[0] - 0.49 - STEP).abs() < 1e-12);
    }
}
