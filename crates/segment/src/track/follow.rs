//! Segments through time: at each time, the scene is deformed once, and each segment is found, measured and joined into
//! components.

use super::events::{EventConfig, SegmentAtTime, Tracking, find_events};
use super::motion::{fill_velocities, window};
use super::statistics::{RowStatus, SegmentStatistics, segment_statistics};
use crate::model::HostGaussians;
use crate::points::PointsError;
use crate::points::components::{ComponentFilter, components_touching, largest_scales};
use crate::segment::colour::constant_colour;
use crate::segment::place::{Cloud, PlaceError, SHARE, SegmentPlaces, scene_grid};
use crate::volume::grid::Grid;

/// Reach of Gaussians that touch, by default: the smallest that keeps a body whole. At 1 bodies break into pieces, which
/// then split and merge: three beads of which two merge at time 0.5 were tracked as 3 parts that become 5. At 1.5, 2.0
/// and 2.5 they are 3 that become 2, at times 0.5, 0.4 and 0.3, as a longer reach joins bodies before they touch; a
/// plume of two pieces that join is right at each of these.
const REACH: f32 = 1.5;

/// Share of support below which a row is weak: less than half.
const WEAK: f64 = 0.5;

/// A segment to track.
#[derive(Clone, Copy, Debug)]
pub struct SegmentToTrack<'a> {
    /// Its name.
    pub name: &'a str,
    /// Indices of its Gaussians.
    pub members: &'a [u32],
    /// The time that it was found at.
    pub time: f64,
}

/// How to track.
#[derive(Clone, Debug, PartialEq)]
pub struct FollowOptions {
    /// Two Gaussians touch if their distance is at most this many times the sum of their largest standard deviations.
    pub reach: f32,
    /// Gaussians less opaque than this connect nothing.
    pub min_opacity: f32,
    /// What counts as an event.
    pub events: EventConfig,
    /// The cells on which segments are measured. They are the same for all segments and times, whichever are requested
    /// and in whatever order, so that volumes are comparable.
    pub grid: Grid,
    /// Times in [0, 1] with training views; empty if unknown.
    pub trained: Vec<f64>,
}

impl FollowOptions {
    /// Returns the defaults for a scene whose box has this centre and these half sides, scene units.
    pub fn within(centre: [f32; 3], half_size: [f32; 3]) -> Self {
        let grid = scene_grid(centre, half_size);
        Self { reach: REACH, min_opacity: 0.05, events: EventConfig::default(), grid, trained: Vec::new() }
    }
}

/// Why segments cannot be tracked.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FollowError {
    /// A member is not a Gaussian of the scene, or an option is out of range.
    #[error(transparent)]
    Points(#[from] PointsError),
    /// Segments have no place.
    #[error(transparent)]
    Place(#[from] PlaceError),
}

/// A segment tracked through time.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackedSegment {
    /// Its name.
    pub name: String,
    /// Its statistics at each time.
    pub statistics: Vec<SegmentStatistics>,
    /// How its parts appeared, vanished, split and merged.
    pub tracking: Tracking,
}

/// Tracks `segments` over `times`, in their order, forward or backward. `others` are the Gaussians of further segments,
/// which occupy places too. `scene` returns the Gaussians of a time, as wide as they are drawn; if it returns `None`,
/// tracking stops and also returns `None`.
///
/// # Errors
/// If a member is not a Gaussian of the scene, or an option is out of range.
pub fn follow(
    mut scene: impl FnMut(f64) -> Option<HostGaussians>,
    segments: &[SegmentToTrack<'_>],
    others: &[&[u32]],
    times: &[f64],
    options: &FollowOptions,
) -> Result<Option<Vec<TrackedSegment>>, FollowError> {
    let mut series: Vec<SegmentSeries> = segments.iter().map(|segment| SegmentSeries::new(segment, times)).collect();
    let mut parties: Option<Vec<Party>> = None;
    for (t, &time) in times.iter().enumerate() {
        let Some(at) = scene(time) else { return Ok(None) };
        if parties.is_none() {
            parties = Some(parties_of(at.len(), segments, others)?);
        }
        // for shaded Gaussians, the colour before lighting
        let (opacity, colours) = (at.opacity(), constant_colour(&at.sh, at.sh_stride.max(1))?);
        let cell = options.grid.spacing[0];
        for party in parties.iter().flatten() {
            let cloud = Cloud::new(&at, &opacity, &party.labels);
            let places = SegmentPlaces::new(cloud, &options.grid, SHARE)?;
            let labels: Vec<u32> = (1..=party.segments.len() as u32).collect();
            let (found, shares) = (places.measure(&labels), places.shares());
            for ((&k, &label), found) in party.segments.iter().zip(&labels).zip(&found) {
                let (segment, series) = (&segments[k], &mut series[k]);
                let mut row = segment_statistics(&cloud, &colours, segment.members, segment.name, time, cell)?;
                row.locate(found.as_ref(), shares.get(label as usize).copied().flatten(), cell);
                series.rows.push(row);
                series.within.push(places.within(label));
                if t == series.origin {
                    series.contents = (0..at.len()).map(|i| cloud.content(i) as f32).collect();
                }
            }
        }
        for (segment, series) in segments.iter().zip(&mut series) {
            series.frames.push(components(&at, segment.members, options)?);
        }
    }
    let finished = segments.iter().zip(series).map(|(segment, series)| series.finish(segment, times, options));
    Ok(Some(finished.collect::<Result<Vec<_>, _>>()?))
}

/// Segments that share no Gaussian, so that their places are found together.
struct Party {
    /// Their positions in the list of segments; the label of each is its place in this list, from 1.
    segments: Vec<usize>,
    /// The label of each Gaussian, 0 for none; those of other segments are higher.
    labels: Vec<u32>,
}

/// Returns the segments in as few parties as possible, each with the labels of all Gaussians of the scene.
fn parties_of(count: usize, segments: &[SegmentToTrack<'_>], others: &[&[u32]]) -> Result<Vec<Party>, PointsError> {
    let mut parties: Vec<Party> = Vec::new();
    for (k, segment) in segments.iter().enumerate() {
        if let Some(&index) = segment.members.iter().find(|&&i| i as usize >= count) {
            return Err(PointsError::Index { field: "members", index, count });
        }
        let free = |party: &Party| segment.members.iter().all(|&i| party.labels[i as usize] == 0);
        let place = parties.iter().position(free).unwrap_or(parties.len());
        if place == parties.len() {
            parties.push(Party { segments: Vec::new(), labels: vec![0; count] });
        }
        let party = &mut parties[place];
        party.segments.push(k);
        let label = party.segments.len() as u32;
        segment.members.iter().for_each(|&i| party.labels[i as usize] = label);
    }
    for party in &mut parties {
        for (label, members) in (party.segments.len() as u32 + 1..).zip(others) {
            for &i in *members {
                if let Some(own @ 0) = party.labels.get_mut(i as usize) {
                    *own = label;
                }
            }
        }
    }
    Ok(parties)
}

/// Returns the component of each of the `members`, and their opacities.
fn components(
    at: &HostGaussians,
    members: &[u32],
    options: &FollowOptions,
) -> Result<(Vec<u32>, Vec<f32>), PointsError> {
    let alone = at.subset(members);
    let opacity = alone.opacity();
    let mut radii = largest_scales(&alone.log_scales)?;
    for (radius, opacity) in radii.iter_mut().zip(&opacity) {
        *radius = if *opacity >= options.min_opacity { *radius } else { 0.0 };
    }
    let filter = ComponentFilter::default();
    let parts = components_touching(&alone.means, &radii, options.reach, &opacity, &filter)?;
    Ok((parts.labels, opacity))
}

/// What is known of one segment so far.
struct SegmentSeries {
    rows: Vec<SegmentStatistics>,
    frames: Vec<(Vec<u32>, Vec<f32>)>,
    /// The Gaussians in its place at each time.
    within: Vec<Vec<u32>>,
    /// Position of the time nearest to the one that it was found at.
    origin: usize,
    /// Content of each Gaussian of the scene at that time.
    contents: Vec<f32>,
}

impl SegmentSeries {
    fn new(segment: &SegmentToTrack<'_>, times: &[f64]) -> Self {
        let away = |i: &usize| (times[*i] - segment.time).abs();
        let origin = (0..times.len()).min_by(|a, b| away(a).total_cmp(&away(b))).unwrap_or(0);
        let (rows, within) = (Vec::with_capacity(times.len()), Vec::with_capacity(times.len()));
        Self { rows, frames: Vec::with_capacity(times.len()), within, origin, contents: Vec::new() }
    }

    fn finish(
        mut self,
        segment: &SegmentToTrack<'_>,
        times: &[f64],
        options: &FollowOptions,
    ) -> Result<TrackedSegment, PointsError> {
        let mut own = vec![false; self.contents.len()];
        segment.members.iter().for_each(|&i| own[i as usize] = true);
        let sum = |of: &mut dyn Iterator<Item = u32>| of.map(|i| f64::from(self.contents[i as usize])).sum::<f64>();
        let members = sum(&mut segment.members.iter().copied());
        let most = self.rows.iter().map(|row| row.extinction).fold(0.0, f64::max);
        for (row, within) in self.rows.iter_mut().zip(&self.within) {
            let there = sum(&mut within.iter().copied());
            let both = sum(&mut within.iter().copied().filter(|i| own[*i as usize]));
            row.consistency = (members + there > 0.0).then(|| 2.0 * both / (members + there));
            let away = options.trained.iter().map(|t| (t - row.time).abs());
            row.trained_distance = away.min_by(f64::total_cmp);
            let gone = row.centroid.is_none() || row.extinction < options.events.presence_share * most;
            let support = row.counted_share.unwrap_or(0.0).min(row.consistency.unwrap_or(0.0));
            row.status = match support {
                _ if gone || support < options.events.min_share => RowStatus::Lost,
                s if s < WEAK => RowStatus::Weak,
                _ => RowStatus::Tracked,
            };
        }
        fill_velocities(&mut self.rows, window(&options.trained));
        let frames: Vec<SegmentAtTime<'_>> = times
            .iter()
            .zip(&self.frames)
            .map(|(&time, (labels, opacity))| SegmentAtTime { time, labels, opacity })
            .collect();
        let tracking = find_events(&frames, &options.events)?;
        Ok(TrackedSegment { name: segment.name.into(), statistics: self.rows, tracking })
    }
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
            ..HostGaussians::default()
        })
    }

    fn rods_followed(members: &[u32]) -> SegmentToTrack<'_> {
        SegmentToTrack { name: "rods", members, time: 0.0 }
    }

    #[test]
    fn a_split_is_found_forward_and_a_merger_backward() {
        let members: Vec<u32> = (0..40).collect();
        let segments = [rods_followed(&members), SegmentToTrack { name: "left", members: &members[..20], time: 0.0 }];
        let forward: Vec<f64> = (0..21).map(|i| i as f64 / 20.0).collect();
        let backward: Vec<f64> = forward.iter().rev().copied().collect();
        let kinds = |times: &[f64]| {
            let all = follow(rods, &segments, &[], times, &FollowOptions::within([0.0; 3], [4.0; 3])).unwrap().unwrap();
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
        assert!((velocity[1] - 1.0).abs() < 0.3, "{velocity:?}");
        let cells: Vec<f64> = all[0].statistics.iter().map(|s| s.cell_size).collect();
        assert!(cells.iter().all(|c| (c - cells[0]).abs() < 1e-6), "one cell for all times");
        let colour = all[0].statistics[0].colour.unwrap();
        assert!(colour.iter().all(|c| (c - 0.5).abs() < 1e-6), "coefficients of 0 are grey: {colour:?}");
        let stopped = follow(
            |t| rods(t).filter(|_| t < 0.5),
            &segments,
            &[],
            &forward,
            &FollowOptions::within([0.0; 3], [4.0; 3]),
        );
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
        let segments = [rods_followed(&members)];
        let times: Vec<f64> = (0..21).map(|i| f64::from(i) / 20.0).collect();
        let found =
            follow(dashed_rods, &segments, &[], &times, &FollowOptions::within([0.0; 3], [4.0; 3])).unwrap().unwrap();
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
    fn measures_at_a_time_depend_on_no_other_time() {
        let members: Vec<u32> = (0..64).collect();
        let segments = [SegmentToTrack { name: "growing", members: &members, time: 1.0 }];
        let last = |times: &[f64]| {
            let found =
                follow(growing, &segments, &[], times, &FollowOptions::within([0.45; 3], [0.6; 3])).unwrap().unwrap();
            let at = found[0].statistics.iter().find(|s| s.time == 1.0).unwrap();
            (at.opaque_core_volume, at.cell_size)
        };
        let (volume, cell) = last(&[1.0]);
        assert_eq!((last(&[0.0, 0.4, 0.6, 1.0]), last(&[1.0, 0.6, 0.4, 0.0])), ((volume, cell), (volume, cell)));
        assert_eq!(cell, FollowOptions::within([0.45; 3], [0.6; 3]).grid.spacing[0]);
        let exact = 64.0 * 4.0 / 3.0 * std::f64::consts::PI * 0.04f64.powi(3);
        assert!((volume / exact - 1.0).abs() < 0.1, "{volume} {exact}");
    }
}
