//! `volseggs track`

use super::run_folder::{RunFolder, check_lens};
use super::shown::Shown;
use super::values::{fraction, pixels, point, positive_f32};
use super::{CliError, Common, print_json};
use crate::data::Camera;
use crate::data::paths::{Lens, orbit};
use crate::files::Work;
use crate::log::progress;
use crate::memory::{Budget, product};
use crate::model::GaussiansAt;
use crate::name::Name;
use crate::segment::pictures::draw;
use crate::track::events::EventKind;
use crate::track::follow::{FollowOptions, Followed, Followup, follow};
use crate::track::report::{PictureOptions, ReportError, ReportFolder, SHEET_CELL};
use burn::tensor::Device;
use clap::Args;
use glam::DVec3;
use rayon::prelude::*;
use std::path::PathBuf;

/// Pictures in the sheet.
const SHEET: usize = 8;
/// Bytes that a time takes for each segment: its statistics, its events, and their rows in the tables.
const ROW_BYTES: usize = 4096;
/// Bytes that a time takes for each Gaussian of a segment.
const MEMBER_BYTES: usize = 8;

/// Follow segments through time: statistics, events, pictures.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs track RUN --segment red.1\n  volseggs track RUN --segment red.1 --segment red.2 --group pair\n  volseggs track RUN --segment red --from 0.5 --to 0     # backward\n  volseggs track RUN --segment red --at 0.1 --at 0.4 --renders --view 3\n\nWrites RUN/track/NAME/: statistics.csv and .json, events.csv, tracks.csv, over-time.svg, velocity-over-time.svg, times.png;\nwith --renders also renders/NNN.png and masks/NNN.png, the segment alone at each time.\nprojected_area is the number of pixels of the mask, projected_share their share of the picture.\nThe edits of the run apply to pictures, masks and projected areas; all else is measured on the scene as trained."
)]
pub struct TrackArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Segment to follow; may be given many times.
    #[arg(long = "segment", value_name = "NAME", required = true)]
    segments: Vec<String>,
    /// Follow them as one, under this name.
    #[arg(long, value_name = "NAME")]
    group: Option<Name>,
    /// First time in [0, 1].
    #[arg(long, value_name = "T", default_value_t = 0.0, value_parser = fraction, allow_negative_numbers = true)]
    from: f64,
    /// Last time in [0, 1]; before the first to go backward.
    #[arg(long, value_name = "T", default_value_t = 1.0, value_parser = fraction, allow_negative_numbers = true)]
    to: f64,
    /// Times, evenly spaced; at least 2.
    #[arg(long, value_name = "N", default_value_t = 51, value_parser = frames)]
    frames: usize,
    /// A time in [0, 1] in place of evenly spaced ones; may be given many times, in any order.
    #[arg(long, value_name = "T", value_parser = fraction, allow_negative_numbers = true, conflicts_with_all = ["from", "to", "frames"])]
    at: Vec<f64>,
    /// Write a picture and a mask of each segment alone at each time.
    #[arg(long)]
    renders: bool,
    /// Least alpha of a pixel of a mask.
    #[arg(long, default_value_t = 0.5, value_name = "ALPHA", value_parser = mask_alpha, allow_negative_numbers = true)]
    mask_alpha: f32,
    /// Camera of the pictures at x,y,z, looking at the centre; one beside the scene if not given.
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    camera: Option<DVec3>,
    /// Take the camera of this test view of the dataset, counted from 0.
    #[arg(long, value_name = "N", conflicts_with = "camera")]
    view: Option<usize>,
    /// Width of the pictures in pixels; the training images' with --renders, else at most 320.
    #[arg(long, value_name = "PIXELS", value_parser = pixels)]
    size: Option<u32>,
    /// Leave out the edits of the run.
    #[arg(long)]
    no_edits: bool,
    #[command(flatten)]
    common: Common,
}

impl TrackArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let run = RunFolder::open_to_write(&self.run, &device, Work::Long)?;
        let wanted = self.wanted(&run)?;
        let segments: Vec<Followed<'_>> = wanted.iter().map(|(name, members)| Followed { name, members }).collect();
        self.check_memory(&wanted)?;
        let times = self.times();
        let camera = self.picture_camera(&run)?;
        let edited = Shown { segments: Vec::new(), no_edits: self.no_edits }.select(&run)?;

        // begun before the work, so that what cannot be replaced is told of at once
        let options = PictureOptions { keep: self.renders, mask_alpha: self.mask_alpha };
        let folder = |(name, _): &(Name, Vec<u32>)| ReportFolder::create(&run.path.join("track"), name, options);
        let mut reports = wanted.iter().map(folder).collect::<Result<Vec<_>, _>>().map_err(report_error)?;
        let bar = progress::bar(times.len(), "times followed");
        let scene = |time: f64| {
            bar.inc(1);
            run.scene.host_at(time as f32)
        };
        let mut found = follow(scene, &segments, &times, &FollowOptions::default()).map_err(CliError::input)?;
        bar.finish_and_clear();

        let bar = progress::bar(times.len(), "times drawn");
        for (i, &time) in times.iter().enumerate() {
            let at = edited.edited(&run.scene, time as f32)?;
            // one after the other: drawing one picture takes all threads
            let pictures: Vec<Vec<f32>> =
                segments.iter().map(|s| alone(&run, &at.subset(s.members), &camera, &device)).collect();
            let label = in_sheet(i, times.len()).then(|| format!("t = {time:.2}"));
            let size = [camera.width as usize, camera.height as usize];
            let add = |(report, rgba): (&mut ReportFolder, &Vec<f32>)| report.add(rgba, size, label.clone());
            reports.par_iter_mut().zip(&pictures).try_for_each(add).map_err(report_error)?;
            bar.inc(1);
        }
        bar.finish_and_clear();
        for (report, followup) in reports.into_iter().zip(&mut found) {
            report.finish(followup).map_err(report_error)?;
        }
        self.print(&run, &camera, &found)
    }

    /// The times in the order in which they are followed.
    fn times(&self) -> Vec<f64> {
        if !self.at.is_empty() {
            let mut times = self.at.clone();
            times.sort_by(f64::total_cmp);
            times.dedup();
            return times;
        }
        let step = (self.to - self.from) / (self.frames - 1) as f64;
        (0..self.frames).map(|i| self.from + step * i as f64).collect()
    }

    /// Refuses more times than can be held: at each, every Gaussian of a segment has a part and an opacity.
    fn check_memory(&self, wanted: &[(Name, Vec<u32>)]) -> Result<(), CliError> {
        let (times, flag) = match self.at.len() {
            0 => (self.frames, format!("--frames {}", self.frames)),
            n => (n, format!("--at, {n} times")),
        };
        let bytes = wanted.iter().map(|(_, members)| ROW_BYTES + MEMBER_BYTES * members.len()).sum();
        Budget::now().check(flag, product(&[times, bytes])).map_err(CliError::input)
    }

    /// Names and members of what is followed.
    fn wanted(&self, run: &RunFolder) -> Result<Vec<(Name, Vec<u32>)>, CliError> {
        let all = run.segments()?;
        let mut wanted: Vec<(Name, Vec<u32>)> = Vec::new();
        for name in &self.segments {
            if wanted.iter().any(|(n, _)| n == name) {
                continue;
            }
            let segment = all.get(name).map_err(CliError::input)?;
            wanted.push((segment.name.clone(), segment.members.clone()));
        }
        if let Some(group) = &self.group {
            let mut members: Vec<u32> = wanted.iter().flat_map(|(_, m)| m).copied().collect();
            members.sort_unstable();
            members.dedup();
            wanted = vec![(group.clone(), members)];
        }
        if let Some((name, _)) = wanted.iter().find(|(_, m)| m.is_empty()) {
            return Err(CliError::input(format!("segment \"{name}\" is empty: there is nothing to follow")));
        }
        Ok(wanted)
    }

    /// The camera of the pictures.
    fn picture_camera(&self, run: &RunFolder) -> Result<Camera, CliError> {
        let (full, sphere) = run.lens(None);
        let width = self.size.unwrap_or(if self.renders { full.width } else { full.width.min(SHEET_CELL) });
        let height = (f64::from(full.height) * f64::from(width) / f64::from(full.width)).round().max(1.0) as u32;
        let lens = Lens { width, height, ..full };
        check_lens(&format!("--size {width}"), lens)?;
        if let Some(eye) = self.camera {
            return run.camera_at(eye, lens);
        }
        if let Some(n) = self.view {
            return Ok(run.test_view(n, lens)?.0);
        }
        Ok(orbit(SHEET, sphere, 20f64.to_radians(), lens).swap_remove(0))
    }

    fn print(&self, run: &RunFolder, camera: &Camera, found: &[Followup]) -> Result<(), CliError> {
        if self.common.json {
            let report = |f: &Followup| {
                serde_json::json!({
                    "segment": f.name, "size": [camera.width, camera.height],
                    "statistics": f.statistics, "events": f.tracking.events,
                })
            };
            return print_json(&found.iter().map(report).collect::<Vec<_>>());
        }
        for followup in found {
            outln!("{}", followup.name);
            for event in followup.tracking.events.iter().filter(|e| e.kind != EventKind::Continue) {
                let list = |v: &[u32]| v.iter().map(ToString::to_string).collect::<Vec<_>>().join(" + ");
                let kind = format!("{:?}", event.kind);
                let (before, after) = (list(&event.parents), list(&event.children));
                outln!("  t = {:.3} to {:.3}  {kind:14} {before} -> {after}", event.time_from, event.time_to);
            }
        }
        errln!("tables and pictures: {}", run.path.join("track").display());
        Ok(())
    }
}

fn report_error(error: ReportError) -> CliError {
    match error {
        ReportError::Replace(error) => error.into(),
        error => CliError::failure(error),
    }
}

/// A number of times that can be followed.
fn frames(text: &str) -> Result<usize, String> {
    let found = text.trim().parse::<usize>().ok().filter(|n| *n >= 2);
    found.ok_or_else(|| "a whole number, at least 2; or give a time with --at".to_owned())
}

/// An alpha that a pixel can have at least.
fn mask_alpha(text: &str) -> Result<f32, String> {
    positive_f32(text).ok().filter(|v| *v <= 1.0).ok_or_else(|| "a number above 0, at most 1".to_owned())
}

/// Colour over the background and alpha, `[H, W, 4]`.
fn alone(run: &RunFolder, segment: &GaussiansAt, camera: &Camera, device: &Device) -> Vec<f32> {
    let spec = &run.scene.spec;
    draw(segment, camera.to_kernel(), spec.background, spec.sh_degree, device)
}

/// Whether the picture of time `i` of `n` is one of those in the sheet, which are spread evenly.
fn in_sheet(i: usize, n: usize) -> bool {
    let count = n.min(SHEET);
    (0..count).any(|k| i == k * (n - 1) / (count - 1).max(1))
}
