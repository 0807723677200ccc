//! `volseggs render`

mod look;

use super::run_folder::RunFolder;
use super::shown::Shown;
use super::{CliError, Common, print_json};
use crate::data::paths::{Lens, orbit, test_spiral};
use crate::data::{Camera, Transforms};
use crate::export::animation::write_apng;
use crate::export::images::{encode_png, to_rgb8};
use crate::files::write_atomic;
use clap::Args;
use glam::DVec3;
use look::{Legend, LookArgs};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Render a run along a path of cameras and times, as PNG files and an animation.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs render checkpoints/first --path test --out frames\n  volseggs render checkpoints/first --path orbit --frames 60 --time 0.5 --size 800 --out orbit\n  volseggs render checkpoints/first --path transforms_test.json --out frames\n  volseggs render checkpoints/first --camera 3,-2,1.5 --time 0.25 --out still\n  volseggs render checkpoints/first --path orbit --segment red --show depth --out depth\n  volseggs render checkpoints/first --show velocity --velocity-axis speed --out velocity\n\nWrites OUT/0000.png, ... and OUT/animation.png (an animated PNG that browsers play).\nVelocities are differences of trained positions over a hundredth of the series to either side; those of edits do not count. The scale's end is exceeded by 1 % of the visible Gaussians. Depth runs from the nearest to the farthest pixel. Both are of the first frame that shows anything, and are told on standard error."
)]
pub struct RenderArgs {
    /// Folder of the run.
    run: PathBuf,
    /// `test` (the 181-view spiral through 100 times), `orbit`, or a transforms_*.json file.
    #[arg(long, default_value = "test")]
    path: String,
    /// A single camera at x,y,z that looks at the centre; in place of --path.
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', num_args = 1, allow_hyphen_values = true)]
    camera: Option<Vec<f64>>,
    /// Hold time at this value in [0, 1]; otherwise it runs from 0 to 1 along the path (0.5 for --camera).
    #[arg(long)]
    time: Option<f64>,
    /// Frames of an orbit.
    #[arg(long, default_value_t = 60)]
    frames: usize,
    /// Width and height in pixels; the training images' if not given.
    #[arg(long, value_name = "PIXELS")]
    size: Option<u32>,
    /// Distance of the camera from the centre; that of the training cameras if not given.
    #[arg(long)]
    radius: Option<f64>,
    /// Frames a second of the animation.
    #[arg(long, default_value_t = 20)]
    fps: u16,
    /// Folder of the frames; made if it is not there.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    look: LookArgs,
    #[command(flatten)]
    shown: Shown,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct Report {
    frames: usize,
    width: u32,
    height: u32,
    render_fps: f64,
    out: PathBuf,
    #[serde(flatten)]
    legend: Option<Legend>,
}

impl RenderArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        if let Some(t) = self.time.filter(|t| !(0.0..=1.0).contains(t)) {
            return Err(CliError::input(format!("--time {t}: between 0 and 1")));
        }
        let run = RunFolder::open(&self.run, &device)?;
        let views = self.views(&run)?;
        let mut look = self.look.open(&run, &device, self.shown.select(&run)?)?;
        std::fs::create_dir_all(&self.out).map_err(|e| CliError::failure(format!("{}: {e}", self.out.display())))?;
        let mut seconds = 0.0;
        let mut images = Vec::with_capacity(views.len());
        for (camera, time) in &views {
            let started = Instant::now();
            let image = look.draw(camera.to_kernel(), *time as f32)?;
            seconds += started.elapsed().as_secs_f64();
            images.push(to_rgb8(&image, camera.width as usize, camera.height as usize));
        }
        for (i, image) in images.iter().enumerate() {
            let path = self.out.join(format!("{i:04}.png"));
            let bytes = encode_png(image).map_err(CliError::failure)?;
            write_atomic(&path, &bytes).map_err(|e| CliError::failure(format!("{}: {e}", path.display())))?;
        }
        let (width, height) = (views[0].0.width, views[0].0.height);
        if images.len() > 1 {
            let frames: Vec<&[u8]> = images.iter().map(|i| i.as_raw().as_slice()).collect();
            write_apng(&self.out.join("animation.png"), frames, width, height, self.fps).map_err(CliError::failure)?;
        }
        let render_fps = views.len() as f64 / seconds;
        let legend = look.legend();
        let report = Report { frames: views.len(), width, height, render_fps, out: self.out, legend };
        errln!(
            "{} frames of {width}x{height} in {}, rendered at {:.1} frames/second",
            report.frames,
            report.out.display(),
            report.render_fps
        );
        if let Some(Legend { legend, .. }) = &report.legend {
            errln!("{legend}");
        }
        if self.common.json {
            print_json(&report)?;
        }
        Ok(())
    }

    fn views(&self, run: &RunFolder) -> Result<Vec<(Camera, f64)>, CliError> {
        if self.size == Some(0) {
            return Err(CliError::input("--size 0: at least 1 pixel"));
        }
        let (lens, distance) = run.lens(self.size);
        let Lens { fov_x, width, height } = lens;
        let centre = DVec3::from_array(run.scene.spec.centre.map(f64::from));
        let radius = self.radius.unwrap_or(distance);
        if let Some(position) = &self.camera {
            let [x, y, z] = position[..] else {
                return Err(CliError::input("--camera: three numbers, such as --camera 3,-2,1.5"));
            };
            let camera = Camera::look_at(DVec3::new(x, y, z), centre, DVec3::Z, fov_x, width, height);
            return Ok(vec![(camera, self.time.unwrap_or(0.5))]);
        }
        let hold = |views: Vec<(Camera, f64)>| match self.time {
            Some(t) => views.into_iter().map(|(c, _)| (c, t)).collect(),
            None => views,
        };
        match self.path.as_str() {
            "test" => Ok(hold(test_spiral(181, 100, radius, lens))),
            "orbit" => {
                let n = self.frames.max(1);
                let cameras = orbit(n, radius, 20f64.to_radians(), lens);
                let last = (n - 1).max(1) as f64;
                Ok(hold(cameras.into_iter().enumerate().map(|(i, c)| (c, i as f64 / last)).collect()))
            }
            file => {
                let json = Transforms::read(Path::new(file))?;
                let views = json
                    .frames
                    .iter()
                    .map(|f| (json.intrinsics.camera(width, height, f.camera_to_world), f.time))
                    .collect();
                Ok(hold(views))
            }
        }
    }
}
