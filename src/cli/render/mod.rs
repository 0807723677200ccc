//! `volseggs render`

mod look;
mod views;

use super::camera::ViewArgs;
use super::data::DataArgs;
use super::shown::ShownArgs;
use super::time::TimeArg;
use super::values::{count, positive};
use super::{CliError, CommonArgs, print_json, stop_flag};
use crate::data::Camera;
use crate::files::same_file;
use crate::log::progress;
use crate::model::ToKernel;
use crate::run::frames::{DrawFrame, FrameBackground, Frames, RenderRecord, check_name, film, is_film};
use crate::run::look::{Legend, Look};
use crate::run::numbers::{self, NumberFormat};
use crate::run::{AnyRun, OpenRun, TrainedModel};
use crate::user_error::UserError;
use clap::{Args, ValueEnum};
use look::LookArgs;
use serde::Serialize;
use serde_json::json;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use views::ViewFromFile;

/// Render a run along a path of cameras and times, as PNG files and an animation.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs render checkpoints/first --path test --out frames\n  volseggs render checkpoints/first --path orbit --frames 60 --time 0.5 --size 800 --out orbit\n  volseggs render checkpoints/first --path transforms_test.json --out frames\n  volseggs render checkpoints/first --camera 3,-2,1.5 --time 0.25 --out still\n  volseggs render checkpoints/first --path orbit --time data:150 --out orbit\n  volseggs render checkpoints/first --view 12 --out still\n  volseggs render checkpoints/first --view volseggs.png --out still\n  volseggs render checkpoints/first --path path.json --out flight.mp4\n  volseggs render checkpoints/first --path orbit --segment red --show depth --out depth\n  volseggs render checkpoints/shaded --light 1,0,1 --out relit\n  volseggs render checkpoints/first --show velocity --velocity-axis speed --out velocity\n  volseggs render checkpoints/first --path orbit --background transparent --out cut-out\n  volseggs render checkpoints/first --view 12 --show depth --out depth.exr        # numbers, not a picture\n  volseggs render checkpoints/first --path test --show velocity --out velocity.npy\n  volseggs render checkpoints/first --path orbit --out frames --json              # prints the cameras too\n\nWrites OUT/0000.png, ..., OUT/animation.png (of two or more frames; an animated PNG that browsers play) and OUT/frames.json (what they show). The folder appears once it is complete.\nVelocities are differences of trained positions over a hundredth of the series to either side; movements by edits do not count. The velocity scale ends where 1 % of the visible Gaussians exceed it; depth runs from the nearest to the farthest pixel. Both scales are those of the first frame that shows anything, and are printed on standard error.\nNumbers are float32, NaN where nothing is visible: depth along the direction of view [H, W], velocity [H, W, 3] or, with --velocity-axis, that component [H, W]; in .npy several frames are stacked, in .exr the channels are Z, V or X, Y, Z."
)]
pub struct RenderArgs {
    /// Folder of the run.
    run: PathBuf,
    /// `test` (the 181-view spiral through 100 times), `orbit`, a transforms_*.json file, or a path of keyframes saved
    /// in `volseggs view`.
    #[arg(long, default_value = "test", conflicts_with_all = ["camera", "view"])]
    path: PathBuf,
    #[command(flatten)]
    view: ViewArgs,
    /// Hold time at this value in [0, 1], or at a time of the data, such as data:150; otherwise it runs from 0 to 1 along the path (0.5 for --camera, the view's
    /// own for --view).
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    time: Option<TimeArg>,
    /// Number of frames of an orbit, 60 if not given; of a path of keyframes, its seconds times --fps if not given.
    #[arg(long, value_name = "N", value_parser = count)]
    frames: Option<usize>,
    /// Distance of the camera from the centre, in the dataset's units; that of the training cameras if not given.
    #[arg(long, value_name = "DISTANCE", value_parser = positive, allow_negative_numbers = true)]
    radius: Option<f64>,
    /// Frames per second of the animation.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u16).range(1..=1000))]
    fps: u16,
    /// Folder for the frames, created if missing; an older render in it is replaced as a whole, anything else is
    /// refused. Or a single film: NAME.png (animated), or NAME.mp4 if the program ffmpeg is installed. Or, with --show
    /// depth or velocity, numbers in the units of the data: NAME.npy, or NAME.exr for a single view.
    #[arg(long, value_name = "DIR|FILE")]
    out: PathBuf,
    /// What is behind the pictures.
    #[arg(long, value_enum, default_value_t = Behind::Scene)]
    background: Behind,
    #[command(flatten)]
    look: LookArgs,
    #[command(flatten)]
    data: DataArgs,
    #[command(flatten)]
    shown: ShownArgs,
    #[command(flatten)]
    common: CommonArgs,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Behind {
    /// The colour of the training images' background.
    Scene,
    /// Nothing: PNG files with straight alpha.
    Transparent,
}

/// What is shown of a run without Gaussians, and the default for runs with Gaussians.
const COLOUR: &str = "colour";

#[derive(Serialize)]
struct RenderReport {
    frames: usize,
    width: u32,
    height: u32,
    render_fps: f64,
    out: String,
    #[serde(flatten)]
    legend: Option<Legend>,
    /// The cameras with their times, as in `transforms_*.json`.
    cameras: serde_json::Value,
}

/// The cameras and times of the frames as a `transforms_*.json`, which `--path` and other programs read. Where the lens
/// changes from frame to frame, it is given for each.
fn cameras(views: &[(Camera, f64)]) -> serde_json::Value {
    let lens = |camera: &Camera| {
        let Camera { width, height, fx, fy, cx, cy, .. } = camera;
        json!({ "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "w": width, "h": height })
    };
    let frame = |(i, (camera, time)): (usize, &(Camera, f64))| {
        let rows = camera.camera_to_world.transpose().to_cols_array_2d();
        json!({ "file_path": format!("./{i:04}"), "transform_matrix": rows, "time": time })
    };
    let mut frames: Vec<serde_json::Value> = views.iter().enumerate().map(frame).collect();
    let lenses: Vec<serde_json::Value> = views.iter().map(|(camera, _)| lens(camera)).collect();
    let mut all = match lenses.first() {
        Some(first) if lenses.iter().all(|lens| lens == first) => first.clone(),
        _ => {
            frames.iter_mut().zip(lenses).for_each(|(frame, lens)| merge(frame, lens));
            json!({})
        }
    };
    merge(&mut all, json!({ "frames": frames }));
    all
}

/// Adds the entries of one JSON object to another.
fn merge(into: &mut serde_json::Value, from: serde_json::Value) {
    if let (Some(into), serde_json::Value::Object(from)) = (into.as_object_mut(), from) {
        into.extend(from);
    }
}

impl RenderArgs {
    /// What is drawn, its name, and the segments shown alone, from the arguments or from a file.
    fn look(&self, run: &OpenRun, saved: Option<&ViewFromFile>) -> Result<(Look, String, Vec<String>), CliError> {
        let Some(ViewFromFile { name, view: saved, .. }) = saved else {
            let look = self.look.open(run, self.shown.select(run)?)?;
            return Ok((look, self.look.name(), self.shown.segments.clone()));
        };
        if let Some(flag) = self.look.given().or(self.shown.given()) {
            return Err(CliError::input(format!(
                "{flag}: cannot be combined with {name}, which defines what is shown"
            )));
        }
        if saved.is_of_another(run) {
            errln!("note: {name} was saved from another scene, {}", saved.run);
        }
        let view = &saved.view;
        let look = view.open_look(run).map_err(|e| match e.is_input() {
            true => CliError::input(format!("{name}: {e}")),
            false => e.into(),
        })?;
        Ok((look, view.look.clone(), view.alone.clone()))
    }

    /// The name of what is shown of a run without Gaussians; rejects options that ask for anything but its colours.
    fn plain(&self, run: &AnyRun, saved: Option<&ViewFromFile>) -> Result<String, CliError> {
        let what = match saved {
            None => self.look.given().or(self.shown.given()).map(str::to_owned),
            Some(ViewFromFile { name, view: saved, .. }) => {
                let view = &saved.view;
                let is_plain = view.look == COLOUR && view.alone.is_empty() && view.hidden.is_empty();
                (!is_plain).then(|| format!("{name} (which shows more than colours)"))
            }
        };
        match what {
            None => Ok(COLOUR.to_owned()),
            Some(what) => Err(CliError::input(format!(
                "{what}: needs Gaussians that stay the same over time, and the method {}, with which {} was trained, has none",
                run.record.method,
                run.path.display()
            ))),
        }
    }

    /// Draws the views into a folder with its record, or into one film; returns the frames per second.
    fn draw<S: TrainedModel>(
        &self,
        run: &OpenRun<S>,
        draw: &mut DrawFrame<'_>,
        views: &[(Camera, f64)],
        record: &RenderRecord,
    ) -> Result<f64, CliError> {
        let background = match self.background {
            Behind::Scene => FrameBackground::Scene,
            Behind::Transparent => FrameBackground::Transparent(run.model().background()),
        };
        let run = run.path.as_path();
        let stop = stop_flag("stopping; nothing is written")?;
        let seconds = if is_film(&self.out) {
            // a picture that holds a view has this program's mark, but the film would not hold the view
            let read = self.view.file().into_iter().chain([self.path.as_path()]);
            if let Some(file) = same_file(&self.out, read) {
                return Err(CliError::input(format!(
                    "--out {}: is the file that --{} reads; choose another name",
                    self.out.display(),
                    if file == self.path { "path" } else { "view" }
                )));
            }
            film(&self.out, draw, views, background, self.fps, &stop)?
        } else {
            let mut needed = vec![run];
            // `orbit` and `test` are names of paths, not files
            needed.extend(self.path.is_file().then_some(self.path.as_path()));
            let mut frames = Frames::create(&self.out, &needed)?;
            frames.draw(draw, views, background, self.fps, &stop)?;
            let seconds = frames.seconds;
            frames.finish(record, run)?;
            seconds
        };
        Ok(views.len() as f64 / seconds)
    }

    /// The record of `views`, except for what they show.
    fn record<S: TrainedModel>(&self, run: &OpenRun<S>, views: &[(Camera, f64)]) -> Result<RenderRecord, CliError> {
        let [width, height] = views.first().map_or([0; 2], |(c, _)| [c.width, c.height]);
        Ok(RenderRecord {
            version: env!("CARGO_PKG_VERSION"),
            run: run.path.display().to_string(),
            path: self.view.choice()?.map_or(self.path.display().to_string(), |c| c.to_string()),
            frames: views.len(),
            size: [width, height],
            times: views.iter().map(|(_, time)| *time).collect(),
            show: COLOUR.to_owned(),
            light: None,
            segments: Vec::new(),
            edits: 0,
            calibration: run.calibration().clone(),
        })
    }

    pub(super) fn run(self) -> Result<(), CliError> {
        check_name(&self.out)?;
        let (_, device) = self.common.device()?;
        let run = self.data.apply_to(AnyRun::open_any(&self.run, &device)?)?;
        let saved = self.saved()?;
        let views = self.views(&run, saved.as_ref())?;
        let record = self.record(&run, &views)?;
        if run.model().scene().is_none() {
            if NumberFormat::by_extension(&self.out).is_some() {
                return Err(CliError::input(format!(
                    "--out {}: numbers are of Gaussians, and the method {}, with which {} was trained, has none that stay \
                     the same over time",
                    self.out.display(),
                    run.record.method,
                    run.path.display()
                )));
            }
            let record = RenderRecord { show: self.plain(&run, saved.as_ref())?, ..record };
            let draw = &mut |camera: &Camera, time: f64| Ok(run.model().render(camera.to_kernel(), time as f32));
            let fps = self.draw(&run, draw, &views, &record)?;
            return self.print(&record, &views, fps, None);
        }
        let run = run.gaussians()?;
        if let Some(format) = NumberFormat::by_extension(&self.out) {
            if let Some(ViewFromFile { name, .. }) = &saved {
                return Err(CliError::input(format!(
                    "--out: {name} is a picture; give --camera or --view N for numbers"
                )));
            }
            return self.numbers(&run, format, &views);
        }
        let (mut look, show, segments) = self.look(&run, saved.as_ref())?;
        let light = self.look.light.map(|v| v.to_array());
        let record = RenderRecord { show, light, segments, edits: look.selection().edits(), ..record };
        let draw = &mut |camera: &Camera, time: f64| look.frame(&run.scene, (camera.to_kernel(), time as f32));
        let fps = self.draw(&run, draw, &views, &record)?;
        self.print(&record, &views, fps, look.legend())
    }

    /// Writes depth or velocity as numbers.
    fn numbers(&self, run: &OpenRun, format: NumberFormat, views: &[(Camera, f64)]) -> Result<(), CliError> {
        let out = self.out.display();
        let Some(quantity) = self.look.quantity()? else {
            return Err(CliError::input(format!(
                "--out {out}: numbers are written of depth and velocity; add --show depth or --show velocity, or write \
                 NAME.png"
            )));
        };
        if self.background == Behind::Transparent {
            return Err(CliError::input("--background: numbers have none, they are NaN where nothing is; omit it"));
        }
        let stop = stop_flag("stopping; nothing is written")?;
        let calibration = &run.record.calibration;
        let shown = self.shown.select(run)?;
        let bar = progress::bar(views.len(), "frames");
        let done = numbers::write(run, &shown, (quantity, calibration), views, (&self.out, format), || {
            bar.inc(1);
            !stop.load(Ordering::Relaxed)
        })?;
        bar.finish_and_clear();
        if !done {
            return Err(CliError::failure("interrupted; nothing was written"));
        }
        let what = quantity.describe(calibration);
        errln!("{what}; {} {}: {out}", views.len(), if views.len() == 1 { "frame" } else { "frames" });
        if self.common.json {
            let out = self.out.display().to_string();
            print_json(&json!({ "frames": views.len(), "out": out, "values": what, "cameras": cameras(views) }))?;
        }
        Ok(())
    }

    fn print(
        &self,
        record: &RenderRecord,
        views: &[(Camera, f64)],
        render_fps: f64,
        legend: Option<Legend>,
    ) -> Result<(), CliError> {
        let ([width, height], out) = (record.size, self.out.display().to_string());
        let report =
            RenderReport { frames: record.frames, width, height, render_fps, out, legend, cameras: cameras(views) };
        errln!(
            "{} {} of {width}x{height} in {}, rendered at {render_fps:.1} frames/second",
            report.frames,
            if report.frames == 1 { "frame" } else { "frames" },
            report.out
        );
        if let Some(Legend { legend, .. }) = &report.legend {
            errln!("{legend}");
        }
        if self.common.json {
            print_json(&report)?;
        }
        Ok(())
    }
}
