//! Propagates a selection made at one time to all others: Gaussians that are invisible at the time of a click and
//! appear at another belong to the object in which they appear.
//!
//! Training may learn a motion as fading: some Gaussians fade out where an object was, others fade in where it is. A
//! click then selects the Gaussians that the object consists of at that time, and none of those that it consists of
//! later. In between, both are visible and overlap: at each of many times, from that of the click outwards, Gaussians
//! that have appeared join the nearest ones that they overlap, whether these are selected or not. If some overlap none,
//! what they replace may have vanished since the time before, the sooner the smaller the Gaussians are: for these,
//! times in between are visited as well. Gaussians that still appear on their own, as a new object does, join none.
//!
//! Fading is rarely complete: at the time of the click, what an object consists of at other times is left as scattered
//! faint [`strays`]. Unless selected, these are treated as invisible then.

use super::pieces::strays;
use crate::config::types::SegmentConfig;
use crate::config::types::segment::PropagateConfig;
use crate::model::{HostGaussians, Scene};
use crate::points::PointsError;
use crate::points::chunks::point;
use crate::points::components::largest_scales;
use crate::points::neighbours::NeighbourGrid;
use rayon::prelude::*;

/// Extends what was `selected` at `time` in [0, 1] among the Gaussians `within` to all times: adds those invisible at
/// that time, or [`strays`] then, that appear in it at another. Both lists and the result are ascending. Where
/// opacities do not change over time, or `segment.propagate.join` is off, the result is `selected`.
///
/// # Errors
/// If arrays of the scene disagree.
pub fn propagate(
    scene: &Scene,
    selected: &[u32],
    within: &[u32],
    time: f64,
    config: &SegmentConfig,
) -> Result<Vec<u32>, PointsError> {
    if !config.propagate.join || !scene.opacity_changes() || within.is_empty() {
        return Ok(selected.to_vec());
    }
    let was: Vec<bool> = within.iter().map(|i| selected.binary_search(i).is_ok()).collect();
    let is = propagated(&was, time, config, |rows| {
        let some = scene.subset(&rows.iter().map(|&n| within[n as usize]).collect::<Vec<u32>>());
        move |time: f64| some.deformed(time as f32)
    })?;
    Ok(within.iter().zip(is).filter(|(_, is)| *is).map(|(i, _)| *i).collect())
}

/// The same for M Gaussians: whether each belongs to what `was` selected, `[M]`. `some` returns for some rows a function
/// that returns these Gaussians at a time.
fn propagated<At: Fn(f64) -> HostGaussians>(
    was: &[bool],
    time: f64,
    config: &SegmentConfig,
    some: impl Fn(&[u32]) -> At,
) -> Result<Vec<bool>, PointsError> {
    let all: Vec<u32> = (0..was.len() as u32).collect();
    let all_at = some(&all);
    let first = all_at(time);
    let (pieces, config) = (&config.pieces, &config.propagate);
    let seen = pieces.min_opacity;
    let stray = if config.strays { strays(&first, pieces)? } else { vec![false; first.len()] };
    let is_known = |i: usize| is_seen(&first, i, seen) && (was[i] || !stray[i]);
    let mut known: Vec<Option<bool>> = (0..was.len()).map(|i| is_known(i).then_some(was[i])).collect();
    for [before, time] in outwards(time, config.step) {
        let after = all_at(time);
        let alone = join(&after, &all, &mut known, (seen, config))?;
        if alone.is_empty() || config.parts == 0 {
            continue;
        }
        let near = with_nearest(&after, &alone, config.near)?;
        let near_at = some(&near);
        for part in (1..=config.parts).map(|part| f64::from(part) / f64::from(config.parts)) {
            join(&near_at(before + (time - before) * part), &near, &mut known, (seen, config))?;
        }
    }
    Ok(known.into_iter().zip(was).map(|(known, was)| known.unwrap_or(*was)).collect())
}

fn is_seen(at: &HostGaussians, row: usize, min_opacity: f32) -> bool {
    at.opacity_of(row) >= min_opacity && at.is_finite(row)
}

/// Returns the times, a `step` apart, from `time` to the end, then from `time` back to the beginning, without `time` itself, each after
/// the one that it is reached from.
fn outwards(time: f64, step: f64) -> Vec<[f64; 2]> {
    let steps = |to: f64| {
        let count = ((to - time).abs() / step).ceil() as usize;
        let after = move |k: usize| if k == count { to } else { time + (to - time).signum() * step * k as f64 };
        (1..=count).map(move |k| [after(k - 1), after(k)])
    };
    steps(1.0).chain(steps(0.0)).collect()
}

/// Lets visible Gaussians that are not `known` yet join what they overlap. Row k of `at` is Gaussian `rows[k]`. Returns
/// those that overlap none.
fn join(
    at: &HostGaussians,
    rows: &[u32],
    known: &mut [Option<bool>],
    (min_opacity, config): (f32, &PropagateConfig),
) -> Result<Vec<u32>, PointsError> {
    let seen = (0..rows.len() as u32).filter(|&k| is_seen(at, k as usize, min_opacity));
    let (there, open): (Vec<u32>, Vec<u32>) = seen.partition(|&k| known[rows[k as usize] as usize].is_some());
    let selected = |k: u32| known[rows[k as usize] as usize] == Some(true);
    for (k, is) in joining(at, &there, &open, selected, config)? {
        known[rows[k as usize] as usize] = Some(is);
    }
    Ok(open.into_iter().map(|k| rows[k as usize]).filter(|&i| known[i as usize].is_none()).collect())
}

/// Returns the Gaussians `alone` and the `count` nearest ones of each, visible or not, ascending.
fn with_nearest(at: &HostGaussians, alone: &[u32], count: usize) -> Result<Vec<u32>, PointsError> {
    let grid = NeighbourGrid::adaptive(&at.means)?;
    let nearest = |&i: &u32| grid.nearest(point(&at.means, i as usize), count, None);
    let mut out: Vec<u32> =
        alone.par_iter().flat_map_iter(nearest).map(|(i, _)| i).chain(alone.par_iter().copied()).collect();
    out.par_sort_unstable();
    out.dedup();
    Ok(out)
}

/// Returns which of the `open` Gaussians overlap any of their nearest among those `there`, and whether most of the
/// opacity of the overlapped ones is `selected`. All are rows of `at`.
fn joining(
    at: &HostGaussians,
    there: &[u32],
    open: &[u32],
    selected: impl Fn(u32) -> bool + Sync,
    config: &PropagateConfig,
) -> Result<Vec<(u32, bool)>, PointsError> {
    if there.is_empty() || open.is_empty() {
        return Ok(Vec::new());
    }
    let radii = largest_scales(&at.log_scales)?;
    let means: Vec<f32> = there.iter().flat_map(|&i| point(&at.means, i as usize)).collect();
    let grid = NeighbourGrid::adaptive(&means)?;
    let vote = |&i: &u32| {
        let mut sums: Option<[f32; 2]> = None;
        for (n, square) in grid.nearest(point(&at.means, i as usize), config.voters, None) {
            let voter = there[n as usize];
            let limit = config.overlap * (radii[i as usize] + radii[voter as usize]);
            if square <= limit * limit {
                sums.get_or_insert_default()[usize::from(selected(voter))] += at.opacity_of(voter as usize);
            }
        }
        sums.map(|[rest, of_selected]| (i, of_selected > rest))
    };
    Ok(open.par_iter().filter_map(vote).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::test_support::{add, on_threads};

    const STEP: f64 = 1.0 / 15.0;
    const SEEN: f32 = 0.02;
    const ALONG: usize = 12;
    const STAGES: usize = 8;

    fn rods(time: f64) -> HostGaussians {
        rods_of(STAGES, time)
    }

    /// Two rods side by side that rise by fading: each has a row of Gaussians at each of several heights, visible while
    /// the rod is near it. Rows of the first rod, then of the second, then one Gaussian that is never visible.
    fn rods_of(stages: usize, time: f64) -> HostGaussians {
        let mut out = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
        for (rod, stage) in (0..2).flat_map(|rod| (0..stages).map(move |s| (rod, s))) {
            let away = (time * (stages - 1) as f64 - stage as f64).abs();
            for k in 0..ALONG {
                add(&mut out, [0.1 * k as f32, 2.0 * rod as f32, 0.12 * stage as f32], [-2.7; 3]);
                *out.opacity_logits.last_mut().unwrap() = if away < 0.8 { 2.0 } else { -8.0 };
            }
        }
        add(&mut out, [0.0; 3], [-2.7; 3]);
        *out.opacity_logits.last_mut().unwrap() = -8.0;
        out
    }

    fn followed(was: &[bool], time: f64, at: impl Fn(f64) -> HostGaussians + Copy) -> Vec<bool> {
        propagated(was, time, &SegmentConfig::default(), |rows| {
            let rows = rows.to_vec();
            move |time| at(time).subset(&rows)
        })
        .unwrap()
    }

    #[test]
    fn gaussians_that_replace_selected_ones_are_selected_and_others_are_not() {
        let n = 2 * STAGES * ALONG + 1;
        for time in [0.0, 0.5, 1.0] {
            let seen = rods(time).opacity();
            let first = |i: usize| i < STAGES * ALONG;
            let was: Vec<bool> = (0..n).map(|i| first(i) && seen[i] > 0.1).collect();
            let found = followed(&was, time, rods);
            assert_eq!(found, (0..n).map(first).collect::<Vec<_>>(), "{time}");
            assert_eq!(found, on_threads(1, || followed(&was, time, rods)));
        }
    }

    #[test]
    fn what_is_replaced_within_a_step_is_followed() {
        let stages = 30;
        let rise = |time: f64| rods_of(stages, time);
        let first = |i: usize| i < stages * ALONG;
        // after one step, all that was visible has vanished, and what has replaced it is too far away to overlap
        let (now, then) = (rise(0.0).opacity(), rise(STEP).opacity());
        assert!(now.iter().zip(&then).all(|(now, then)| now.min(*then) < SEEN));
        for time in [0.0, 0.5, 1.0] {
            let seen = rise(time).opacity();
            let was: Vec<bool> = (0..seen.len()).map(|i| first(i) && seen[i] > 0.1).collect();
            assert_eq!(followed(&was, time, rise), (0..seen.len()).map(first).collect::<Vec<_>>(), "{time}");
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
            assert_eq!(followed(&was, time, remains), (0..at.len()).map(first).collect::<Vec<_>>(), "{time}");
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
        assert_eq!(followed(&was, 0.5, poisoned), was);
        assert_eq!(followed(&[], 0.5, |_| HostGaussians { sh_stride: 1, ..HostGaussians::default() }), [false; 0]);
    }

    #[test]
    fn times_go_outwards_and_reach_both_ends() {
        let times = outwards(0.49, STEP);
        let reached: Vec<f64> = times.iter().map(|[_, time]| *time).collect();
        assert!(reached.contains(&0.0) && reached.contains(&1.0) && !reached.contains(&0.49));
        assert_eq!((times.len(), outwards(1.0, STEP).len()), (16, 15));
        assert!((times[0][1] - 0.49 - STEP).abs() < 1e-12);
        let from = |[before, _]: &[f64; 2]| *before == 0.49 || reached.contains(before);
        assert!(times.iter().all(|step| from(step) && (step[1] - step[0]).abs() < STEP + 1e-12));
    }
}
