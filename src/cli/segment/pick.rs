//! `volseggs segment pick`

use super::super::camera::{ViewArgs, surroundings};
use super::super::data::DataArgs;
use super::super::error::refuse;
use super::super::settings::SegmentSettings;
use super::super::time::TimeArg;
use super::super::values::{cosine_f32, count, fraction_f32};
use super::super::{CliError, CommonArgs, print_json};
use crate::config::types::segment::LevelsConfig;
use crate::data::Camera;
use crate::files::LockDuration;
use crate::name::Name;
use crate::run::cameras::check_lens;
use crate::run::pick::{ClickError, ClickHit, Clicking, commit};
use crate::run::segments::RunSegments;
use crate::run::{OpenRun, affinity};
use crate::segment::levels::{Level, LevelKind};
use crate::segment::pick::{Granularity, PickOptions};
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;

/// Show what is under a click; with --name, make a segment of what it selects.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs segment pick RUN --camera 3,-2,1.5 --pixel 210,180              # which segments are there\n  volseggs segment pick RUN --view 12 --pixel 210,180 --levels         # from parts to wholes\n  volseggs segment pick RUN --view 12 --pixel 210,180 --name vortex            # the most likely level\n  volseggs segment pick RUN --view 12 --pixel 210,180 --name vortex --level 1\n  volseggs segment pick RUN --view 12 --pixel 210,180 --name vortex --within red --scale 0.3 --threshold 0.9\n\nThe picture is the one that `volseggs render` draws from the same camera; pixels are counted from its top left corner."
)]
pub struct PickArgs {
    /// Folder of the run.
    run: PathBuf,
    #[command(flatten)]
    view: ViewArgs,
    /// Column and row of the clicked pixel.
    #[arg(long, value_name = "X,Y", value_delimiter = ',', num_args = 1, required = true, allow_hyphen_values = true)]
    pixel: Vec<u32>,
    /// Time in [0, 1], or a time of the data, such as data:150; if not given, that of the test view, or else the one at which the segments were found.
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    time: Option<TimeArg>,
    /// Make a segment with this name.
    #[arg(long)]
    name: Option<Name>,
    /// Search only this segment, as if the others were hidden; if not given, the clicked colour.
    #[arg(long, value_name = "SEGMENT")]
    within: Option<String>,
    /// Show the levels at the click, from small parts to large wholes, see --level.
    #[arg(long)]
    levels: bool,
    /// Use this level, the likeliest if not given: its number, from 1, the smallest, or `piece` (the connected piece of the
    /// segment at the click), `part` (the clicked part of a piece that has several), `segment` (all of it), `object`
    /// (the clicked part with what belongs to it of other segments, such as a core with its shell).
    #[arg(long, value_name = "N|KIND", value_parser = level, conflicts_with_all = ["scale", "threshold"])]
    level: Option<Granularity>,
    /// Mask scale in [0, 1], from small parts to large ones, instead of a level.
    #[arg(long, value_parser = fraction_f32)]
    scale: Option<f32>,
    /// Minimum cosine between the affinity features of the click and of what it selects, instead of a level.
    #[arg(long, value_parser = cosine_f32)]
    threshold: Option<f32>,
    /// Keep small pieces that do not touch the rest (`segment.pieces.strays = false`).
    #[arg(long)]
    keep_strays: bool,
    #[command(flatten)]
    settings: SegmentSettings,
    #[command(flatten)]
    data: DataArgs,
    #[command(flatten)]
    common: CommonArgs,
}

#[derive(Serialize)]
struct PickReport {
    /// The clicked Gaussian.
    gaussian: u32,
    /// Its fraction of the pixel's colour.
    weight: f32,
    /// Its position, scene units.
    mean: [f32; 3],
    /// Its position in the coordinates of the data, or in scene units if these are unknown.
    position: [f64; 3],
    /// Their unit of length; `normalised` if they are unknown.
    unit: String,
    /// Segments that contain it, wholes before their parts.
    segments: Vec<String>,
    /// The segment made, with its number of Gaussians.
    made: Option<(Name, usize)>,
    /// Number of these that are visible only at times other than that of the click.
    from_other_times: usize,
    /// The levels at the click, from small to large, if requested.
    levels: Vec<ShownLevel>,
    /// The one that was used, from 1, if they were requested.
    level: Option<usize>,
    /// Seconds from the click to the selection.
    seconds: f64,
    /// Seconds to propagate the selection to the other times.
    carry_seconds: f64,
}

/// A level at the click.
#[derive(Serialize)]
struct ShownLevel {
    /// What makes its Gaussians one.
    kind: LevelKind,
    /// Mask scale in [0, 1], if it is the affinity.
    scale: Option<f32>,
    /// Minimum cosine of a member, if it is the affinity.
    threshold: Option<f32>,
    /// Fraction, in (0, 1], that remains if the cosine rises by 0.05, if it is the affinity.
    stability: Option<f64>,
    /// Its fraction of what the whole scene shows, in [0, 1].
    share: f64,
    /// Number of Gaussians, including strays.
    gaussians: usize,
}

impl ShownLevel {
    fn of(level: &Level) -> Self {
        let Level { kind, share, .. } = *level;
        let similar = kind == LevelKind::Similar;
        Self {
            kind,
            scale: similar.then_some(level.scale),
            threshold: similar.then_some(level.threshold),
            stability: similar.then_some(level.stability),
            share,
            gaussians: level.members.len(),
        }
    }
}

/// Parses the number of a level, from 1, or its kind.
fn level(text: &str) -> Result<Granularity, String> {
    let kind = LevelKind::SPATIAL.into_iter().find(|kind| kind.name() == text);
    let number = || count(text).map(|n| Granularity::Level(n - 1));
    kind.map(Granularity::OfKind).map_or_else(number, Ok).map_err(|_| {
        let names = LevelKind::SPATIAL.map(LevelKind::name).join(", ");
        format!("expected a whole number, at least 1, or one of {names}")
    })
}

impl PickArgs {
    /// The meaning of the click according to the options.
    fn meaning(&self, levels: &LevelsConfig) -> Granularity {
        match (self.level, self.scale, self.threshold) {
            (Some(level), _, _) => level,
            (None, None, None) => Granularity::Likeliest,
            (None, s, t) => Granularity::By { scale: s.unwrap_or(levels.scale), threshold: t.unwrap_or(levels.cosine) },
        }
    }

    /// Rejects options that would have no effect.
    fn check(&self) -> Result<(), CliError> {
        if self.name.is_some() {
            return Ok(());
        }
        let meaning = [
            ("--level", self.level.is_some() && !self.levels),
            ("--scale", self.scale.is_some() && !self.levels),
            ("--threshold", self.threshold.is_some() && !self.levels),
        ];
        refuse(&meaning, "selects what a new segment contains; add --name NAME, or list the levels with --levels")?;
        // levels are listed with their strays
        let strays = [("--keep-strays", self.keep_strays)];
        refuse(&strays, "affects what a new segment contains; name it with --name NAME")
    }

    pub(super) fn run(self) -> Result<(), CliError> {
        let [x, y] = self.pixel[..] else {
            return Err(CliError::input("--pixel: give two numbers, such as --pixel 210,180"));
        };
        self.check()?;
        let run = match self.name {
            Some(_) => self.common.open_to_write(&self.run, LockDuration::Short)?,
            None => self.common.open(&self.run)?,
        };
        let mut run = self.settings.apply_to(self.data.apply_to(run)?)?;
        run.config.segment.pieces.strays &= !self.keep_strays;
        let mut segments = RunSegments::open(&run)?;
        let (camera, view_time) = self.seen_from(&run)?;
        let all = segments.now().clone();
        let found_at = all.segments.first().map(|s| s.time);
        let given = self.time.map(|time| time.to_scene_time("--time", run.calibration())).transpose()?;
        let time = given.or(view_time).or(found_at).unwrap_or(0.5);
        let wants = self.name.is_some() || self.levels;
        let field = if wants { Some(affinity::open(&run)?) } else { None };

        let clicking = Clicking::new(&run, &all, field.as_ref(), time);
        let click = |e: ClickError| match e {
            ClickError::Run(error) => error.into(),
            other => CliError::input(format!("--pixel {x},{y}: {other}")),
        };
        let started = Instant::now();
        let hit = clicking.hit(&camera, [x, y], self.within.as_deref()).map_err(click)?;
        let (mut made, mut picked) = (None, None);
        if wants {
            let (meaning, list) = (self.meaning(&run.config.segment.levels), self.levels);
            let found = clicking.select(&hit, &PickOptions { meaning, list });
            picked = Some(found.map_err(|e| match e {
                ClickError::Level { .. } => CliError::input(format!("--{e}; list them with --levels")),
                other => click(other),
            })?);
        }
        let seconds = started.elapsed().as_secs_f64();
        if let (Some(name), Some(picked)) = (&self.name, &picked) {
            made = Some((name.clone(), commit(&run, &mut segments, name, &hit, picked, time)?));
        }
        let carry_seconds = started.elapsed().as_secs_f64() - seconds;
        if made.is_some() {
            segments.save()?;
        }
        let ClickHit { gaussian, weight, mean, .. } = hit;
        let known = run.calibration();
        let report = PickReport {
            gaussian,
            weight,
            mean,
            position: known.position(mean.map(f64::from)),
            unit: known.length_unit().to_owned(),
            segments: hit.segments.iter().map(ToString::to_string).collect(),
            from_other_times: made.as_ref().map_or(0, |(_, made)| made.from_other_times),
            made: made.map(|(name, made)| (name, made.gaussians)),
            levels: picked.iter().flat_map(|p| &p.levels).map(ShownLevel::of).collect(),
            level: picked.as_ref().and_then(|p| p.level).map(|n| n + 1),
            seconds,
            carry_seconds,
        };
        if self.common.json {
            return print_json(&report);
        }
        let (share, at) = (100.0 * weight, report.position);
        outln!("Gaussian {gaussian}, {share:.0} % of the pixel, at {at:.3?} ({})", report.unit);
        let list = if report.segments.is_empty() { "none".into() } else { report.segments.join(", ") };
        outln!("in segments: {list}");
        if self.levels {
            show(&report);
        }
        if let (Some((name, count)), Some(picked)) = (&report.made, &picked) {
            let level = report.level.map_or(String::new(), |n| format!("level {n} of {}, ", report.levels.len()));
            let (scale, threshold) = (picked.scale, picked.threshold);
            let by = match picked.kind {
                LevelKind::Similar => format!("scale {scale:.2}, cosine {threshold:.3}"),
                kind => kind.name().to_owned(),
            };
            let (click, carry) = (1e3 * report.seconds, 1e3 * report.carry_seconds);
            let others = report.from_other_times;
            outln!(
                "{name}: {count} Gaussians, {others} of them from other times, {level}{by}; {click:.0} + {carry:.0} ms"
            );
        }
        Ok(())
    }

    /// The camera, and the time of a test view.
    fn seen_from(&self, run: &OpenRun) -> Result<(Camera, Option<f64>), CliError> {
        let around = surroundings(run, self.view.size);
        check_lens(&format!("--size {}", around.lens.width), around.lens)?;
        let Some(choice) = self.view.choice()? else {
            return Err(CliError::input("--camera: give three numbers, such as --camera 3,-2,1.5; or --view N|FILE"));
        };
        Ok(run.view(&choice, around.lens)?)
    }
}

/// Prints the levels, one line each.
fn show(report: &PickReport) {
    outln!("level  kind     Gaussians  of the scene  scale  cosine  stability");
    for (n, l) in (1..).zip(&report.levels) {
        let mark = if report.level == Some(n) { "  <- used" } else { "" };
        let share = format!("{:.1} %", 100.0 * l.share);
        let by = match (l.scale, l.threshold, l.stability) {
            (Some(scale), Some(cosine), Some(stability)) => {
                format!("{scale:>5.2}  {cosine:>6.2}  {:>7.0} %", 100.0 * stability)
            }
            _ => String::new(),
        };
        let line = format!("{n:>5}  {:<7}  {:>9}  {share:>12}  {by:<24}{mark}", l.kind.name(), l.gaussians);
        outln!("{}", line.trim_end());
    }
}
