//! Tracking of a run's segments through time: statistics, events, and pictures of each segment alone.

use super::selection::Selection;
use super::{OpenRun, RunError};
use crate::data::{Calibration, Camera, SplitName};
use crate::memory::{MemoryBudget, product};
use crate::model::ToKernel;
use crate::name::Name;
use crate::segment::pictures::draw;
use crate::segment::segmentation::SegmentOrigin;
use crate::track::follow::{self as track, FollowOptions, SegmentToTrack, TrackedSegment};
use crate::track::report::{PictureOptions, ReportFolder, TrackReportError};
use crate::track::statistics::{RowStatus, SegmentStatistics};
use rayon::prelude::*;
use std::path::Path;

/// Maximum number of pictures in the sheet of a segment.
pub const SHEET: usize = 8;
/// Bytes per time and segment: its statistics, its events, and their rows in the tables.
const ROW_BYTES: usize = 4096;
/// Bytes per time and Gaussian of a segment: its part, its opacity, and its number in a list.
const MEMBER_BYTES: usize = 12;

/// Times in [0, 1], in the order in which segments are tracked. They are listed only once memory is known to suffice.
#[derive(Clone, Debug, PartialEq)]
pub enum TrackedTimes {
    /// Evenly spaced times, backward if `to` is before `from`.
    Even {
        /// First time.
        from: f64,
        /// Last time.
        to: f64,
        /// Number of times, at least 2.
        frames: usize,
    },
    /// These times, in any order; they are sorted, and duplicates removed.
    At(Vec<f64>),
}

impl TrackedTimes {
    /// Returns an upper bound on the number of times.
    pub fn count(&self) -> usize {
        match self {
            Self::Even { frames, .. } => *frames,
            Self::At(times) => times.len(),
        }
    }

    /// Lists all times.
    pub fn list(&self) -> Vec<f64> {
        match self {
            Self::Even { from, to, frames } => {
                let step = (to - from) / (frames - 1) as f64;
                (0..*frames).map(|i| from + step * i as f64).collect()
            }
            Self::At(times) => {
                let mut times = times.clone();
                times.sort_by(f64::total_cmp);
                times.dedup();
                times
            }
        }
    }
}

/// What to track, and how to show it.
#[derive(Clone, Copy, Debug)]
pub struct FollowRequest<'a> {
    /// Names of segments.
    pub segments: &'a [String],
    /// Track them as one segment of this name.
    pub group: Option<&'a Name>,
    /// When to track them.
    pub times: &'a TrackedTimes,
    /// The option that set the number of times, such as `--frames 51`, for the error if they do not fit into memory.
    pub asked: &'a str,
    /// Camera of the pictures.
    pub camera: &'a Camera,
    /// Whether the run's edits apply to the pictures; everything else is measured on the scene as trained.
    pub edited: bool,
    /// Which pictures to keep.
    pub pictures: PictureOptions,
    /// Where the folder of each segment goes, instead of into the run.
    pub out: Option<&'a Path>,
}

/// Progress, reported for each time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FollowProgress {
    /// Segments were tracked at another time.
    Followed,
    /// Segments were drawn at another time.
    Drawn,
}

/// Measures segments, separately or as one, at `times` and finds their events, on the scene as trained, in the units of
/// the data; nothing is written. `asked` is what set the number of times, see [`FollowRequest::asked`]. Returns `None` if `goes_on`, called
/// at each time, stopped it.
///
/// # Errors
/// If a name is unknown, a segment is empty, or the times do not fit into memory.
pub fn measure(
    run: &OpenRun,
    segments: &[String],
    group: Option<&Name>,
    (times, asked): (&TrackedTimes, &str),
    goes_on: impl FnMut() -> bool,
) -> Result<Option<Vec<TrackedSegment>>, RunError> {
    let wanted = wanted(run, segments, group)?;
    check_memory(&wanted, times, asked)?;
    follow_all(run, &wanted, &times.list(), goes_on)
}

/// Tracks segments, in the units of the data, and writes a folder for each, into the run's folder of tracks unless the
/// request names another. Returns `None` if `goes_on`, called at
/// each time, stopped it; earlier folders are then unchanged.
///
/// # Errors
/// If a name is unknown, a segment is empty, the group has the name of a segment with other Gaussians, the times do not
/// fit into memory, or results cannot be written.
pub fn follow(
    run: &OpenRun,
    request: &FollowRequest<'_>,
    mut goes_on: impl FnMut(FollowProgress) -> bool,
) -> Result<Option<Vec<TrackedSegment>>, RunError> {
    let wanted = wanted(run, request.segments, request.group)?;
    let folder = request.out.map_or_else(|| run.paths().tracks(), Path::to_owned);
    if request.out.is_none() {
        check_group(run, &wanted)?;
    }
    check_memory(&wanted, request.times, request.asked)?;
    let times = &request.times.list()[..];
    let shown = Selection::open(run, &[], request.edited)?;

    // created before the work, so that a folder that cannot be replaced is reported at once
    let report = |w: &Wanted| ReportFolder::create(&folder, &w.name, request.pictures);
    let mut reports = wanted.iter().map(report).collect::<Result<Vec<_>, _>>().map_err(report_error)?;
    let found = follow_all(run, &wanted, times, || goes_on(FollowProgress::Followed))?;
    let Some(mut found) = found else { return Ok(None) };

    let (camera, rendering, device) = (request.camera, run.scene.spec.rendering(), run.device());
    for (i, &time) in times.iter().enumerate() {
        let at = shown.edited(&run.scene, time as f32)?;
        // one after the other: drawing a single picture uses all threads
        let alone = |w: &Wanted| draw(&at.subset(&w.members), rendering.seen_by(camera.to_kernel()), &device);
        let pictures: Vec<Vec<f32>> = wanted.iter().map(alone).collect();
        let label = in_sheet(i, times.len()).then(|| format!("t = {time:.2}"));
        let size = [camera.width as usize, camera.height as usize];
        let add = |(report, rgba): (&mut ReportFolder, &Vec<f32>)| report.add(rgba, size, label.clone());
        reports.par_iter_mut().zip(&pictures).try_for_each(add).map_err(report_error)?;
        if !goes_on(FollowProgress::Drawn) {
            return Ok(None);
        }
    }
    for (report, followup) in reports.into_iter().zip(&mut found) {
        report.finish(followup, run.calibration()).map_err(report_error)?;
    }
    Ok(Some(found))
}

/// Checks that the times fit into memory.
fn check_memory(wanted: &[Wanted], times: &TrackedTimes, asked: &str) -> Result<(), RunError> {
    let bytes = wanted.iter().map(|w| ROW_BYTES + MEMBER_BYTES * w.members.len()).sum();
    // at each time, every Gaussian of a segment has a part and an opacity
    MemoryBudget::now().check(asked, product(&[times.count(), bytes])).map_err(RunError::input)
}

fn follow_all(
    run: &OpenRun,
    wanted: &[Wanted],
    times: &[f64],
    mut goes_on: impl FnMut() -> bool,
) -> Result<Option<Vec<TrackedSegment>>, RunError> {
    let segments: Vec<SegmentToTrack<'_>> =
        wanted.iter().map(|w| SegmentToTrack { name: &w.name, members: &w.members, time: w.time }).collect();
    let all = run.segments()?;
    let others =
        all.leaves().iter().map(|name| all.get(name)).collect::<Result<Vec<_>, _>>().map_err(RunError::input)?;
    let others: Vec<&[u32]> =
        others.into_iter().filter(|s| s.origin != SegmentOrigin::Group).map(|s| s.members.as_slice()).collect();
    let widening = run.widening();
    let scene = |time: f64| goes_on().then(|| run.scene.host_at(time as f32).widened(widening));
    let spec = &run.scene.spec;
    let options = FollowOptions { trained: trained_times(run), ..FollowOptions::within(spec.centre, spec.half_size) };
    let mut found = track::follow(scene, &segments, &others, times, &options).map_err(RunError::input)?;
    let rows = found.iter_mut().flatten().flat_map(|followup| &mut followup.statistics);
    rows.for_each(|row| row.calibrate(run.calibration()));
    Ok(found)
}

/// The times in [0, 1] with training views, ascending; none if the run's dataset is no longer there.
fn trained_times(run: &OpenRun) -> Vec<f64> {
    let views = run.dataset().ok().and_then(|data| SplitName::Train.views(&data).ok());
    let mut times: Vec<f64> = views.iter().flat_map(|views| &views.frames).map(|frame| frame.time).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    times
}

/// Returns what a reader of the tables should know about how far they can be relied on, one sentence each.
pub fn cautions(found: &TrackedSegment, calibration: &Calibration) -> Vec<String> {
    let rows = &found.statistics;
    let of = |n: usize| format!("{n} of {} times", rows.len());
    let count = |which: &dyn Fn(&SegmentStatistics) -> bool| rows.iter().filter(|row| which(row)).count();
    let mut said = Vec::new();
    let lost = count(&|row| row.status == RowStatus::Lost);
    if lost > 0 {
        said.push(format!("it is lost at {}: nothing, or hardly anything, of it is left there", of(lost)));
    }
    let weak = count(&|row| row.status == RowStatus::Weak);
    if weak > 0 {
        said.push(format!(
            "at {} less than half of it supports its place (columns counted_share and consistency)",
            of(weak)
        ));
    }
    let ends = rows.first().zip(rows.last()).map_or(0.0, |(first, last)| (last.time - first.time).abs());
    let spacing = ends / rows.len().saturating_sub(1).max(1) as f64;
    // farther from a trained time than from the next row
    let far = |d: f64| d / calibration.duration() > spacing * (1.0 + 1e-6);
    let between = count(&|row| row.trained_distance.is_some_and(far));
    if 2 * between > rows.len() {
        said.push(format!(
            "few of these times were trained: {} are between those with training views, where motion is only \
             interpolated (column trained_distance)",
            of(between)
        ));
    }
    said
}

/// A segment to track.
struct Wanted {
    name: Name,
    members: Vec<u32>,
    /// The time that it was found at.
    time: f64,
}

/// Returns the names and members of the segments to track.
fn wanted(run: &OpenRun, segments: &[String], group: Option<&Name>) -> Result<Vec<Wanted>, RunError> {
    let all = run.segments()?;
    let mut wanted: Vec<Wanted> = Vec::new();
    for name in segments {
        if wanted.iter().any(|w| &w.name == name) {
            continue;
        }
        let segment = all.get(name).map_err(RunError::input)?;
        wanted.push(Wanted { name: segment.name.clone(), members: segment.members.clone(), time: segment.time });
    }
    if let Some(group) = group {
        let mut members: Vec<u32> = wanted.iter().flat_map(|w| &w.members).copied().collect();
        members.sort_unstable();
        members.dedup();
        let time = wanted.first().map_or(0.0, |w| w.time);
        wanted = vec![Wanted { name: group.clone(), members, time }];
    }
    if let Some(Wanted { name, .. }) = wanted.iter().find(|w| w.members.is_empty()) {
        return Err(RunError::input(format!("segment \"{name}\" is empty: there is nothing to track")));
    }
    Ok(wanted)
}

/// Checks that no track would have the name of a segment with other Gaussians: a group's would replace that of the
/// segment, or be taken for it.
fn check_group(run: &OpenRun, wanted: &[Wanted]) -> Result<(), RunError> {
    let all = run.segments()?;
    match wanted.iter().find(|w| all.get(&w.name).is_ok_and(|s| s.members != w.members)) {
        Some(Wanted { name, .. }) => Err(RunError::input(format!(
            "group {name}: this is the name of a segment with other Gaussians, whose track it would replace; choose \
             another name"
        ))),
        None => Ok(()),
    }
}

fn report_error(error: TrackReportError) -> RunError {
    match error {
        TrackReportError::Replace(error) => error.into(),
        error => RunError::failure(error),
    }
}

/// Returns whether the picture of time `i` of `n` is in the sheet, whose pictures are evenly spread.
fn in_sheet(i: usize, n: usize) -> bool {
    let count = n.min(SHEET);
    (0..count).any(|k| i == k * (n - 1) / (count - 1).max(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_run_forward_or_backward_and_each_is_listed_once() {
        let even = |from, to, frames| TrackedTimes::Even { from, to, frames }.list();
        assert_eq!(even(0.0, 1.0, 5), [0.0, 0.25, 0.5, 0.75, 1.0]);
        assert_eq!(even(0.5, 0.0, 2), [0.5, 0.0]);
        assert_eq!(TrackedTimes::At(vec![0.4, 0.1, 0.4]).list(), [0.1, 0.4]);
        assert_eq!(
            TrackedTimes::Even { from: 0.0, to: 1.0, frames: usize::MAX }.count(),
            usize::MAX,
            "without listing them"
        );
    }

    #[test]
    fn the_pictures_of_the_sheet_are_spread_evenly() {
        let shown = |n: usize| (0..n).filter(|i| in_sheet(*i, n)).collect::<Vec<_>>();
        assert_eq!((shown(1), shown(2)), (vec![0], vec![0, 1]));
        assert_eq!(shown(51), [0, 7, 14, 21, 28, 35, 42, 50]);
    }
}
