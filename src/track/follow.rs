//! Segments through time: at each time, the scene is deformed once, and each segment's Gaussians are described and
//! joined into components.

use super::events::{EventConfig, Frame, Tracking, find_events};
use super::statistics::{Gaussians, SegmentStatistics, StatisticsConfig, fill_velocities, segment_statistics};
use crate::model::HostGaussians;
use crate::points::PointsError;
use crate::points::components::{ComponentFilter, components_touching, largest_scales};
use crate::segment::colour::constant_colour;

/// Cells of the volumes along the longest side of the scene's box. A segment is often a tenth of that, about 25 cells,
/// and one that extends over two boxes is still within what [`super::volume::union_volume`] accepts without coarsening.
const CELLS: f32 = 256.0;

/// Reach of Gaussians that touch, by default: the smallest that keeps a body whole. At 1 bodies break into pieces, which
/// then split and merge: three beads of which two merge at time 0.5 were tracked as 3 parts that become 5. At 1.5, 2.0
/// and 2.5 they are 3 that become 2, at times 0.5, 0.4 and 0.3, as a longer reach joins bodies before they touch; a
/// plume of two pieces that join is right at each of these.
const REACH: f32 = 1.5;

/// A segment to track.
#[derive(Clone, Copy, Debug)]
pub struct Followed<'a> {
    /// Its name.
    pub name: &'a str,
    /// Indices of its Gaussians.
    pub members: &'a [u32],
}

/// How to track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowOptions {
    /// Two Gaussians touch if their distance is at most this many times the sum of their largest standard deviations.
    pub reach: f32,
    /// Gaussians less opaque than this connect nothing.
    pub min_opacity: f32,
    /// What counts as an event.
    pub events: EventConfig,
    /// Cell side of the volumes, world units. It is the same for all segments and times, whichever are requested and in
    /// whatever order, so that volumes are comparable.
    pub volume_cell: f32,
}

impl FollowOptions {
    /// Returns the defaults for a scene whose box has these half sides, world units.
    #[must_use]
    pub fn within(half_size: [f32; 3]) -> Self {
        let volume_cell = 2.0 * half_size.into_iter().fold(0.0, f32::max) / CELLS;
        Self { reach: REACH, min_opacity: 0.05, events: EventConfig::default(), volume_cell }
    }
}

/// A segment tracked through time.
#[derive(Clone, Debug, PartialEq)]
pub struct Followup {
    /// Its name.
    pub name: String,
    /// Its statistics at each time.
    pub statistics: Vec<SegmentStatistics>,
    /// How its parts appeared, vanished, split and merged.
    pub tracking: Tracking,
}

/// Tracks `segments` over `times`, in their order, forward or backward. `scene` returns the Gaussians of a time; if it
/// returns `None`, tracking stops and also returns `None`.
///
/// # Errors
/// If a member is not a Gaussian of the scene, or an option is out of range.
pub fn follow(
    mut scene: impl FnMut(f64) -> Option<HostGaussians>,
    segments: &[Followed<'_>],
    times: &[f64],
    options: &FollowOptions,
) -> Result<Option<Vec<Followup>>, PointsError> {
    let mut statistics = vec![Vec::with_capacity(times.len()); segments.len()];
    let mut frames: Vec<Vec<(Vec<u32>, Vec<f32>)>> = vec![Vec::with_capacity(times.len()); segments.len()];
    let config = StatisticsConfig { volume_cell: Some(options.volume_cell), ..StatisticsConfig::default() };
    for &time in times {
        let Some(at) = scene(time) else { return Ok(None) };
        // for shaded Gaussians, the colour before lighting
        let (opacity, colours) = (at.opacity(), constant_colour(&at.sh, at.sh_stride.max(1))?);
        let all = Gaussians {
            means: &at.means,
            opacity: &opacity,
            log_scales: &at.log_scales,
            rotations: &at.rotations,
            colours: &colours,
        };
        for (k, segment) in segments.iter().enumerate() {
            statistics[k].push(segment_statistics(&all, segment.members, segment.name, time, &config)?);
            let alone = at.subset(segment.members);
            let opacity = alone.opacity();
            let mut radii = largest_scales(&alone.log_scales)?;
            for (radius, opacity) in radii.iter_mut().zip(&opacity) {
                *radius = if *opacity >= options.min_opacity { *radius } else { 0.0 };
            }
            let filter = ComponentFilter::default();
            let parts = components_touching(&alone.means, &radii, options.reach, &opacity, &filter)?;
            frames[k].push((parts.labels, opacity));
        }
    }
    let parts = segments.iter().zip(statistics).zip(frames);
    parts
        .map(|((segment, mut statistics), frames)| {
            fill_velocities(&mut statistics);
            let frames: Vec<Frame<'_>> =
                times.iter().zip(&frames).map(|(&time, (labels, opacity))| Frame { time, labels, opacity }).collect();
            let tracking = find_events(&frames, &options.events)?;
            Ok(Followup { name: segment.name.into(), statistics, tracking })
        })
        .collect::<Result<Vec<_>, _>>()
        .map(Some)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::events::EventKind;

    /// Two rods that lie end to end and move apart after half the time.
    fn rods(time: f64) -> Option<HostGaussians> {
        let n = 40;
        let apart = (4.0 * (time - 0.5)).max(0.0) as f32;
        let place = |i: usize| 0.05 * i as f32 + if i < n / 2 { -apart } else { apart };
        Some(HostGaussians {
            means: (0..n).flat_map(|i| [place(i), time as f32, 0.0]).collect(),
            rotations: [1.0, 0.0, 0.0, 0.0].repeat(n),
            log_scales: vec![0.04f32.ln(); 3 * n],
            opacity_logits: vec![1.0; n],
            sh: vec![0.0; 3 * n],
            sh_stride: 1,
            shading: None,
            embedding: None,
        })
    }

    #[test]
    fn a_split_is_found_forward_and_a_merger_backward() {
        let members: Vec<u32> = (0..40).collect();
        let segments =
            [Followed { name: "rods", members: &members }, Followed { name: "left", members: &members[..20] }];
        let forward: Vec<f64> = (0..21).map(|i| i as f64 / 20.0).collect();
        let backward: Vec<f64> = forward.iter().rev().copied().collect();
        let kinds = |times: &[f64]| {
            let all = follow(rods, &segments, times, &FollowOptions::within([1.0; 3])).unwrap().unwrap();
            let of = |k: usize| {
                let found = all[k].tracking.events.iter().map(|e| e.kind);
                found.filter(|k| *k != EventKind::Continue).collect::<Vec<_>>()
            };
            (of(0), of(1), all)
        };
        let (rods_forward, left, all) = kinds(&forward);
        assert_eq!((rods_forward, left), (vec![EventKind::Split], vec![]));
        assert_eq!(kinds(&backward).0, [EventKind::Merge]);
        let velocity = all[0].statistics[10].velocity.unwrap();
        assert!((velocity[1] - 1.0).abs() < 1e-4, "{velocity:?}");
        let cells: Vec<f64> = all[0].statistics.iter().map(|s| s.volume_cell).collect();
        assert!(cells.iter().all(|c| (c - cells[0]).abs() < 1e-6), "one cell for all times");
        let colour = all[0].statistics[0].colour.unwrap();
        assert!(colour.iter().all(|c| (c - 0.5).abs() < 1e-6), "coefficients of 0 are grey: {colour:?}");
        let stopped = follow(|t| rods(t).filter(|_| t < 0.5), &segments, &forward, &FollowOptions::within([1.0; 3]));
        assert_eq!(stopped.unwrap(), None);
    }

    /// The [`rods`] with a gap after every fifth Gaussian, wider than the sum of two standard deviations.
    fn dashed_rods(time: f64) -> Option<HostGaussians> {
        let mut at = rods(time)?;
        at.means.chunks_exact_mut(3).enumerate().for_each(|(i, mean)| mean[0] += 0.05 * (i / 5) as f32);
        Some(at)
    }

    #[test]
    fn gaussians_slightly_apart_are_one_body() {
        let members: Vec<u32> = (0..40).collect();
        let segments = [Followed { name: "rods", members: &members }];
        let times: Vec<f64> = (0..21).map(|i| f64::from(i) / 20.0).collect();
        let found = follow(dashed_rods, &segments, &times, &FollowOptions::within([1.0; 3])).unwrap().unwrap();
        let tracking = &found[0].tracking;
        let parts = |time: f64| tracking.points.iter().filter(|p| p.time == time).count();
        assert_eq!((parts(0.0), parts(1.0)), (1, 2));
        let kinds = tracking.events.iter().map(|e| e.kind).filter(|k| *k != EventKind::Continue);
        assert_eq!(kinds.collect::<Vec<_>>(), [EventKind::Split]);
    }

    /// One visible ball and, after half the time, 63 others that form a cube with it, apart from each other.
    fn growing(time: f64) -> Option<HostGaussians> {
        let n = 64;
        let place = |i: usize| [i % 4, i / 4 % 4, i / 16].map(|k| 0.3 * k as f32);
        let shows = |i: usize| i == 0 || time > 0.5;
        Some(HostGaussians {
            means: (0..n).flat_map(place).collect(),
            rotations: [1.0, 0.0, 0.0, 0.0].repeat(n),
            log_scales: vec![0.04f32.ln(); 3 * n],
            opacity_logits: (0..n).map(|i| if shows(i) { 1.0 } else { -20.0 }).collect(),
            ..HostGaussians::zeros(n, 1)
        })
    }

    #[test]
    fn the_volume_at_a_time_depends_on_no_other_time() {
        let members: Vec<u32> = (0..64).collect();
        let segments = [Followed { name: "growing", members: &members }];
        let last = |times: &[f64]| {
            let found = follow(growing, &segments, times, &FollowOptions::within([1.0; 3])).unwrap().unwrap();
            let at = found[0].statistics.iter().find(|s| s.time == 1.0).unwrap();
            (at.volume, at.volume_cell)
        };
        let (volume, cell) = last(&[1.0]);
        assert_eq!((last(&[0.0, 0.4, 0.6, 1.0]), last(&[1.0, 0.6, 0.4, 0.0])), ((volume, cell), (volume, cell)));
        assert_eq!(cell, f64::from(FollowOptions::within([1.0; 3]).volume_cell));
        let exact = 64.0 * 4.0 / 3.0 * std::f64::consts::PI * 0.04f64.powi(3);
        assert!((volume / exact - 1.0).abs() < 0.1, "{volume} {exact}");
    }
}
