//! `volseggs segment pick`

use super::super::run_folder::RunFolder;
use super::super::values::{cosine_f32, count, fraction, fraction_f32, pixels, point};
use super::super::{CliError, Common, print_json};
use super::affinity;
use super::history::History;
use crate::data::Camera;
use crate::files::Work;
use crate::memory::{Budget, product};
use crate::model::params::to_vec;
use crate::name::Name;
use crate::segment::click::{heaviest, under};
use crate::segment::levels::Level;
use crate::segment::masks::sheet::distinct_colour;
use crate::segment::pick::{Asked, Meaning, PickOptions, meant, pick};
use crate::segment::segmentation::{Origin, Segment};
use clap::Args;
use glam::DVec3;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;

/// What is under a click; with --name, a segment of what it means.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs segment pick RUN --camera 3,-2,1.5 --pixel 210,180              # which segments are there\n  volseggs segment pick RUN --view 12 --pixel 210,180 --levels         # from parts to wholes\n  volseggs segment pick RUN --view 12 --pixel 210,180 --name vortex            # the likeliest of them\n  volseggs segment pick RUN --view 12 --pixel 210,180 --name vortex --level 1\n  volseggs segment pick RUN --view 12 --pixel 210,180 --name vortex --within red --scale 0.3 --threshold 0.9\n\nThe picture is the one that `volseggs render` draws from the same camera; pixels count from its top left."
)]
pub struct PickArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Camera at x,y,z that looks at the centre.
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    camera: Option<DVec3>,
    /// Test view of the dataset, from 0, in place of --camera.
    #[arg(long, value_name = "N", conflicts_with = "camera")]
    view: Option<usize>,
    /// Column and row that are clicked.
    #[arg(long, value_name = "X,Y", value_delimiter = ',', num_args = 1, required = true)]
    pixel: Vec<u32>,
    /// Pixels a side of the picture; those of the training images if not given.
    #[arg(long, value_parser = pixels)]
    size: Option<u32>,
    /// Time in [0, 1]; that of the test view, or else the one at which the segments were found.
    #[arg(long, value_parser = fraction)]
    time: Option<f64>,
    /// Make a segment of this name.
    #[arg(long)]
    name: Option<Name>,
    /// Look in this segment only, as if the others were hidden; in the clicked colour if not given.
    #[arg(long, value_name = "SEGMENT")]
    within: Option<String>,
    /// Show the levels at the click, from small parts to large wholes: what stays the same while the cosine changes.
    #[arg(long)]
    levels: bool,
    /// Take this level, from 1, the smallest; the likeliest if not given.
    #[arg(long, value_name = "N", value_parser = count, conflicts_with_all = ["scale", "threshold"])]
    level: Option<usize>,
    /// Mask scale in [0, 1], from small parts to large ones, in place of a level.
    #[arg(long, value_parser = fraction_f32)]
    scale: Option<f32>,
    /// Cosine of the affinity features that what is like the click has at least, in place of a level.
    #[arg(long, value_parser = cosine_f32, allow_negative_numbers = true)]
    threshold: Option<f32>,
    /// Keep small pieces that do not touch the rest.
    #[arg(long)]
    keep_strays: bool,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct Report {
    /// The clicked Gaussian.
    gaussian: u32,
    /// Its part of the pixel's colour.
    weight: f32,
    /// Where it is, world units.
    mean: [f32; 3],
    /// Segments that hold it, wholes before their parts.
    segments: Vec<String>,
    /// The segment made, with the number of its Gaussians.
    made: Option<(Name, usize)>,
    /// The levels at the click, from small to large, if they were asked for.
    levels: Vec<Shown>,
    /// The one that was taken, from 1, if they were asked for.
    level: Option<usize>,
    /// Seconds from the click to the segment.
    seconds: f64,
}

/// A level.
#[derive(Serialize)]
struct Shown {
    /// Mask scale in [0, 1].
    scale: f32,
    /// Cosine that a member has at least.
    threshold: f32,
    /// Whether it is all that hangs together with the click, whatever the cosine.
    piece: bool,
    /// What stays of it if the cosine rises by 0.05, in (0, 1].
    stability: f64,
    /// Its part of what is looked at, by what it shows, in (0, 1].
    share: f64,
    /// Gaussians, strays among them.
    gaussians: usize,
}

impl Shown {
    fn of(level: &Level) -> Self {
        let Level { scale, threshold, piece, stability, share, .. } = *level;
        Self { scale, threshold, piece, stability, share, gaussians: level.members.len() }
    }
}

impl PickArgs {
    /// What the click means, as far as it is said.
    fn meaning(&self) -> Meaning {
        let (scale, threshold) = Meaning::BY_HAND;
        match (self.level, self.scale, self.threshold) {
            (Some(n), _, _) => Meaning::Level(n - 1),
            (None, None, None) => Meaning::Likeliest,
            (None, s, t) => Meaning::By { scale: s.unwrap_or(scale), threshold: t.unwrap_or(threshold) },
        }
    }

    pub(super) fn run(self) -> Result<(), CliError> {
        let [x, y] = self.pixel[..] else {
            return Err(CliError::input("--pixel: two numbers, such as --pixel 210,180"));
        };
        let (_, device) = self.common.device()?;
        let run = match self.name {
            Some(_) => RunFolder::open_to_write(&self.run, &device, Work::Short)?,
            None => RunFolder::open(&self.run, &device)?,
        };
        let mut history = History::open(&run)?;
        let mut all = history.now().clone();
        let (camera, view_time) = self.seen_from(&run)?;
        let found_at = all.segments.first().map(|s| s.time);
        let time = self.time.or(view_time).or(found_at).unwrap_or(0.5);
        let within = self.within.as_ref().map(|name| all.get(name)).transpose().map_err(CliError::input)?.cloned();
        let wants = self.name.is_some() || self.levels;
        let field = if wants { Some(affinity(&run, &device)?) } else { None };

        let at = run.scene.host_at(time as f32);
        // the field knows the places of the time that it was trained at
        let places = match &field {
            Some((_, spec)) if spec.time != time => to_vec(run.scene.at(spec.time as f32).means),
            _ => at.means.clone(),
        };
        let started = Instant::now();
        let shown = within.as_ref().map(|s| at.subset(&s.members));
        let beneath = under(shown.as_ref().unwrap_or(&at), camera.to_kernel(), [x, y], &device).map_err(|_| {
            CliError::input(format!("--pixel {x},{y}: the picture has {}x{}", camera.width, camera.height))
        })?;
        // wholes come before their parts
        let whole_of =
            |i: u32| (0..).zip(&all.segments).find(|(_, s)| s.members.binary_search(&i).is_ok()).map(|(n, _)| n);
        let hit = match within {
            // what is to become a segment is looked for in one, see `meant`
            None if wants => meant(&beneath, whole_of),
            _ => heaviest(&beneath, |_| true),
        };
        let Some(hit) = hit else {
            return Err(CliError::input(format!("--pixel {x},{y}: nothing is there at time {time}")));
        };
        let weight = beneath.iter().find(|(i, _)| *i == hit).map_or(0.0, |(_, w)| *w);
        let gaussian = within.as_ref().map_or(hit, |s| s.members[hit as usize]);
        let holds = |s: &&Segment| s.members.binary_search(&gaussian).is_ok();
        let segments: Vec<String> = all.segments.iter().filter(holds).map(|s| s.name.to_string()).collect();
        let (mut made, mut picked) = (None, None);
        if let Some((field, spec)) = field {
            let whole = within.or_else(|| all.segments.iter().find(holds).cloned());
            let candidates = whole.as_ref().map_or_else(|| (0..at.len() as u32).collect(), |s| s.members.clone());
            let asked = Asked { field: &field, frame: &spec.frame, places: &places };
            let (meaning, keep_strays, list) = (self.meaning(), self.keep_strays, self.levels);
            let options = PickOptions { meaning, keep_strays, list };
            let mut found = pick(&asked, &at, &candidates, gaussian, &options).map_err(CliError::failure)?;
            if self.level.is_some_and(|n| n > found.levels.len()) {
                let (n, count) = (self.level.unwrap_or_default(), found.levels.len());
                return Err(CliError::input(format!("--level {n}: there are {count} at this click; see --levels")));
            }
            if let Some(name) = &self.name {
                let members = std::mem::take(&mut found.members);
                if members.is_empty() {
                    return Err(CliError::input(format!(
                        "{name}: nothing but strays is like the click; choose another pixel, another --level or a lower \
                         --threshold, or pass --keep-strays"
                    )));
                }
                made = Some((name.clone(), members.len()));
                let colour = distinct_colour(all.segments.len()).map(|c| f32::from(c) / 255.0);
                let origin = Origin::Pick { scale: found.scale, threshold: found.threshold };
                let (name, parent) = (name.clone(), whole.map(|s| s.name));
                all.add(Segment { name, parent, colour, time, origin, members }).map_err(CliError::input)?;
            }
            picked = Some(found);
        }
        let seconds = started.elapsed().as_secs_f64();
        if let Some((name, _)) = &made {
            history.change(format!("pick {name}"), all.segments.clone());
            history.save()?;
        }
        let mean = [0, 1, 2].map(|k| at.means[3 * gaussian as usize + k]);
        let levels = picked.iter().flat_map(|p| &p.levels).map(Shown::of).collect();
        let level = picked.as_ref().and_then(|p| p.level).map(|n| n + 1);
        let report = Report { gaussian, weight, mean, segments, made, levels, level, seconds };
        if self.common.json {
            return print_json(&report);
        }
        outln!("Gaussian {gaussian}, {:.0} % of the pixel, at {mean:.3?}", 100.0 * weight);
        let list = if report.segments.is_empty() { "none".into() } else { report.segments.join(", ") };
        outln!("in segments: {list}");
        if self.levels {
            show(&report);
        }
        if let (Some((name, count)), Some(picked)) = (&report.made, &picked) {
            let level = report.level.map_or(String::new(), |n| format!("level {n} of {}, ", report.levels.len()));
            let (scale, threshold) = (picked.scale, picked.threshold);
            let by =
                if picked.piece { "in one piece".into() } else { format!("scale {scale:.2}, cosine {threshold:.3}") };
            outln!("{name}: {count} Gaussians, {level}{by}; {:.0} ms", 1e3 * seconds);
        }
        Ok(())
    }

    fn seen_from(&self, run: &RunFolder) -> Result<(Camera, Option<f64>), CliError> {
        let (lens, _) = run.lens(self.size);
        let side = |n: u32| n as usize;
        let what = format!("--size {}", lens.width.max(lens.height));
        Budget::now().check(what, product(&[side(lens.width), side(lens.height), 16])).map_err(CliError::input)?;
        if let Some(n) = self.view {
            let (camera, time) = run.test_view(n, lens)?;
            return Ok((camera, Some(time)));
        }
        let Some(eye) = self.camera else {
            return Err(CliError::input("--camera: three numbers, such as --camera 3,-2,1.5; or --view N"));
        };
        Ok((run.camera_at(eye, lens)?, None))
    }
}

/// The levels, a line each.
fn show(report: &Report) {
    outln!("level  Gaussians   share  stability  scale  cosine");
    for (n, l) in (1..).zip(&report.levels) {
        let mark = if report.level == Some(n) { "  <- taken" } else { "" };
        let [share, stability] = [l.share, l.stability].map(|v| format!("{:.0} %", 100.0 * v));
        let by = if l.piece { "in one piece".into() } else { format!("{:>5.2}  {:>6.2}", l.scale, l.threshold) };
        outln!("{n:>5}  {:>9}  {share:>6}  {stability:>9}  {by:<13}{mark}", l.gaussians);
    }
}
