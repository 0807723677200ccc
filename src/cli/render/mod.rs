//! `volseggs render`

mod look;
mod views;

use super::camera::ViewArgs;
use super::shown::ShownArgs;
use super::values::{count, fraction, positive};
use super::{CliError, Common, print_json, stop_flag};
use crate::run::OpenRun;
use crate::run::cameras::ViewChoice;
use crate::run::frames::{Frames, Record};
use crate::run::look::{Legend, Look};
use clap::Args;
use look::LookArgs;
use serde::Serialize;
use std::path::PathBuf;

/// Render a run along a path of cameras and times, as PNG files and an animation.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs render checkpoints/first --path test --out frames\n  volseggs render checkpoints/first --path orbit --frames 60 --time 0.5 --size 800 --out orbit\n  volseggs render checkpoints/first --path transforms_test.json --out frames\n  volseggs render checkpoints/first --camera 3,-2,1.5 --time 0.25 --out still\n  volseggs render checkpoints/first --view 12 --out still\n  volseggs render checkpoints/first --view volseggs.png --out still\n  volseggs render checkpoints/first --path orbit --segment red --show depth --out depth\n  volseggs render checkpoints/first --show velocity --velocity-axis speed --out velocity\n\nWrites OUT/0000.png, ..., OUT/animation.png (an animated PNG that browsers play) and OUT/frames.json (what they show). The folder appears when all of it is there.\nVelocities are differences of trained positions over a hundredth of the series to either side; those of edits do not count. The scale's end is exceeded by 1 % of the visible Gaussians. Depth runs from the nearest to the farthest pixel. Both are of the first frame that shows anything, and are told on standard error."
)]
pub struct RenderArgs {
    /// Folder of the run.
    run: PathBuf,
    /// `test` (the 181-view spiral through 100 times), `orbit`, or a transforms_*.json file.
    #[arg(long, default_value = "test")]
    path: PathBuf,
    #[command(flatten)]
    view: ViewArgs,
    /// Hold time at this value in [0, 1]; otherwise it runs from 0 to 1 along the path (0.5 for --camera, the view's own for --view).
    #[arg(long, value_name = "T", value_parser = fraction, allow_negative_numbers = true)]
    time: Option<f64>,
    /// Frames of an orbit; 60 if not given.
    #[arg(long, value_name = "N", value_parser = count)]
    frames: Option<usize>,
    /// Distance of the camera from the centre; that of the training cameras if not given.
    #[arg(long, value_name = "DISTANCE", value_parser = positive, allow_negative_numbers = true)]
    radius: Option<f64>,
    /// Frames a second of the animation.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u16).range(1..=1000))]
    fps: u16,
    /// Folder of the frames; made if it is not there. An older render in it is replaced whole; anything else is refused.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    look: LookArgs,
    #[command(flatten)]
    shown: ShownArgs,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct Report {
    frames: usize,
    width: u32,
    height: u32,
    render_fps: f64,
    out: String,
    #[serde(flatten)]
    legend: Option<Legend>,
}

impl RenderArgs {
    /// What is drawn, its name, and the segments that are shown alone: as it is typed, or as a saved view says.
    fn look(&self, run: &OpenRun, choice: Option<&ViewChoice>) -> Result<(Look, String, Vec<String>), CliError> {
        let Some(ViewChoice::Saved { name, saved }) = choice else {
            let look = Look::open(run, self.shown.select(run)?, self.look.show()?)?;
            return Ok((look, self.look.name(), self.shown.segments.clone()));
        };
        if let Some(flag) = self.look.given().or(self.shown.given()) {
            return Err(CliError::input(format!("{flag}: does not go with --view {name}, which says what is shown")));
        }
        if saved.is_of_another(run) {
            errln!("note: {name} was saved of another scene, {}", saved.run);
        }
        let view = &saved.view;
        let look = view.look(run, Vec::new()).map_err(|e| match e.is_input() {
            true => CliError::input(format!("--view {name}: {e}")),
            false => e.into(),
        })?;
        Ok((look, view.look.clone(), view.alone.clone()))
    }

    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let run = OpenRun::open(&self.run, &device)?;
        let choice = self.view.choice()?;
        let views = self.views(&run, choice.as_ref())?;
        let (mut look, show, segments) = self.look(&run, choice.as_ref())?;
        let edits = look.selection().edits();
        let mut needed = vec![run.path.as_path()];
        // `orbit` and `test` are names of paths, not of files
        needed.extend(self.path.is_file().then_some(self.path.as_path()));
        let mut frames = Frames::create(&self.out, &needed)?;
        let stop = stop_flag("stopping; nothing is written")?;
        frames.draw((&run, &device), &mut look, &views, self.fps, &stop)?;
        let render_fps = views.len() as f64 / frames.seconds;
        let [width, height] = views.first().map_or([0; 2], |(c, _)| [c.width, c.height]);
        let record = Record {
            version: env!("CARGO_PKG_VERSION"),
            run: run.path.display().to_string(),
            path: choice.map_or(self.path.display().to_string(), |c| c.to_string()),
            frames: views.len(),
            size: [width, height],
            times: views.iter().map(|(_, time)| *time).collect(),
            show,
            segments,
            edits,
        };
        frames.finish(&record, &run)?;
        let out = self.out.display().to_string();
        let report = Report { frames: views.len(), width, height, render_fps, out, legend: look.legend() };
        errln!(
            "{} frames of {width}x{height} in {}, rendered at {render_fps:.1} frames/second",
            report.frames,
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
