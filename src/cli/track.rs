//! `volseggs track`

use super::camera::{ViewArgs, surroundings};
use super::data::DataArgs;
use super::error::or_elsewhere;
use super::time::TimeArg;
use super::values::positive_f32;
use super::{CliError, CommonArgs, command_line, print_json};
use crate::data::Camera;
use crate::files::LockDuration;
use crate::log::progress;
use crate::name::Name;
use crate::run::OpenRun;
use crate::run::cameras::check_lens;
use crate::run::follow::{FollowProgress, FollowRequest, SHEET, TrackedTimes, cautions, follow};
use crate::track::events::{EventKind, SegmentEvent};
use crate::track::follow::TrackedSegment;
use crate::track::report::{PictureOptions, SHEET_CELL};
use crate::track::tables::units;
use clap::Args;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Track segments through time: statistics, events, pictures.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs track RUN --segment red.1\n  volseggs track RUN --segment red.1 --segment red.2 --group pair\n  volseggs track RUN --segment red --from 0.5 --to 0     # backward\n  volseggs track RUN --segment red --at 0.1 --at 0.4 --renders --view 3\n  volseggs track /shared/run --segment red --out my-tracks     # a run that cannot be written to\n\nWrites RUN/track/NAME/, or with --out DIR/NAME/: statistics.csv and .json, columns.csv (what each column\nis and its unit), events.csv, tracks.csv, over-time.svg, velocity-over-time.svg, times.png;\nwith --renders also renders/NNN.png and masks/NNN.png, the segment alone at each time.\nprojected_area is the number of pixels of the mask, projected_share their share of the picture.\nThe edits of the run apply to pictures, masks and projected areas; everything else is measured on the scene as trained."
)]
pub struct TrackArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Segment to track; may be repeated.
    #[arg(long = "segment", value_name = "NAME", required = true)]
    segments: Vec<String>,
    /// Track them as one segment, under this name.
    #[arg(long, value_name = "NAME")]
    group: Option<Name>,
    /// First time: in [0, 1], or a time of the data, such as data:150.
    #[arg(long, value_name = "T", default_value_t = TimeArg::Scene(0.0), allow_negative_numbers = true)]
    from: TimeArg,
    /// Last time, given likewise; if it is before the first, tracking goes backward.
    #[arg(long, value_name = "T", default_value_t = TimeArg::Scene(1.0), allow_negative_numbers = true)]
    to: TimeArg,
    /// Number of times, evenly spaced; at least 2.
    #[arg(long, value_name = "N", default_value_t = 51, value_parser = frames)]
    frames: usize,
    /// A time, given likewise, instead of evenly spaced ones; may be repeated, in any order.
    #[arg(long, value_name = "T", allow_negative_numbers = true, conflicts_with_all = ["from", "to", "frames"])]
    at: Vec<TimeArg>,
    /// Write a picture and a mask of each segment alone at each time.
    #[arg(long)]
    renders: bool,
    /// Minimum alpha of a mask's pixels.
    #[arg(long, default_value_t = 0.5, value_name = "ALPHA", value_parser = mask_alpha, allow_negative_numbers = true)]
    mask_alpha: f32,
    #[command(flatten)]
    view: ViewArgs,
    #[command(flatten)]
    data: DataArgs,
    /// Ignore the edits of the run.
    #[arg(long)]
    no_edits: bool,
    /// Write DIR/NAME/ instead, and nothing into RUN: for runs of others. An older track in it is replaced as a whole,
    /// anything else is refused.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    common: CommonArgs,
}

impl TrackArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let run = match &self.out {
            Some(_) => OpenRun::open(&self.run, &device)?,
            None => {
                OpenRun::open_to_write(&self.run, &device, &command_line(), LockDuration::Long).map_err(or_elsewhere)?
            }
        };
        let run = self.data.apply_to(run)?;
        let (times, camera) = (self.times(&run)?, self.picture_camera(&run)?);
        let asked = match self.at.len() {
            0 => format!("--frames {}", self.frames),
            n => format!("--at, {n} times"),
        };
        let request = FollowRequest {
            segments: &self.segments,
            group: self.group.as_ref(),
            times: &times,
            asked: &asked,
            camera: &camera,
            edited: !self.no_edits,
            pictures: PictureOptions { keep: self.renders, mask_alpha: self.mask_alpha },
            out: self.out.as_deref(),
        };
        let tracked = progress::bar(times.count(), "times tracked");
        let drawn = progress::bar(times.count(), "times drawn");
        let found = follow(&run, &request, |stage| {
            match stage {
                FollowProgress::Followed => tracked.inc(1),
                FollowProgress::Drawn => {
                    tracked.finish_and_clear();
                    drawn.inc(1);
                }
            }
            true
        })?;
        drawn.finish_and_clear();
        self.print(&run, &camera, &found.unwrap_or_default())
    }

    fn times(&self, run: &OpenRun) -> Result<TrackedTimes, CliError> {
        let of = |time: TimeArg, flag: &str| time.to_scene_time(flag, run.calibration());
        Ok(if self.at.is_empty() {
            TrackedTimes::Even { from: of(self.from, "--from")?, to: of(self.to, "--to")?, frames: self.frames }
        } else {
            TrackedTimes::At(self.at.iter().map(|time| of(*time, "--at")).collect::<Result<_, _>>()?)
        })
    }

    /// The camera of the pictures.
    fn picture_camera(&self, run: &OpenRun) -> Result<Camera, CliError> {
        let full = surroundings(run, None);
        let width = if self.renders { full.lens.width } else { full.lens.width.min(SHEET_CELL) };
        let around = full.sized(self.view.size.unwrap_or(width));
        check_lens(&format!("--size {}", around.lens.width), around.lens)?;
        match self.view.choice()? {
            Some(choice) => Ok(run.view(&choice, around.lens)?.0),
            None => Ok(around.orbit(SHEET).swap_remove(0)),
        }
    }

    fn print(&self, run: &OpenRun, camera: &Camera, found: &[TrackedSegment]) -> Result<(), CliError> {
        for followup in found {
            cautions(followup, run.calibration())
                .iter()
                .for_each(|caution| errln!("note: {}: {caution}", followup.name));
        }
        if self.common.json {
            let units: BTreeMap<_, _> = units(run.calibration()).into_iter().collect();
            let report = |f: &TrackedSegment| {
                serde_json::json!({
                    "segment": f.name, "size": [camera.width, camera.height],
                    "units": units, "statistics": f.statistics, "events": f.tracking.events,
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
                let SegmentEvent { time_from, time_to, confidence, .. } = event;
                outln!(
                    "  t = {time_from:.3} to {time_to:.3}  {kind:14} {before} -> {after}  confidence {confidence:.2}"
                );
            }
        }
        let folder = self.out.clone().unwrap_or_else(|| run.paths().tracks());
        errln!("tables and pictures: {}", folder.display());
        Ok(())
    }
}

/// Parses a number of times that can be tracked.
fn frames(text: &str) -> Result<usize, String> {
    let found = text.trim().parse::<usize>().ok().filter(|n| *n >= 2);
    found.ok_or_else(|| "expected a whole number, at least 2; or give a time with --at".to_owned())
}

/// Parses the minimum alpha of a mask's pixels.
fn mask_alpha(text: &str) -> Result<f32, String> {
    positive_f32(text).ok().filter(|v| *v <= 1.0).ok_or_else(|| "expected a number above 0, at most 1".to_owned())
}
