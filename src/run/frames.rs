//! The folder of a render: frames, written as they are drawn, their animation, and the record of what they show; or a
//! film in a single file.

use super::RunError;
use crate::data::{Calibration, Camera};
use crate::export::animation::{AnimationError, try_write_apng};
use crate::export::images::{encode_samples, to_rgb8, to_rgba8};
use crate::export::video::{Mp4, VideoError};
use crate::files::{AtomicDir, FolderKind};
use png::ColorType;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Name of the record.
const RECORD: &str = "frames.json";
/// Name of the animation.
const ANIMATION: &str = "animation.png";

/// Kind of a render's folder, which the next render may replace.
const KIND: FolderKind = FolderKind {
    what: "a folder of rendered frames",
    markers: &[RECORD],
    entries: &["[0-9][0-9][0-9][0-9]*.png", ANIMATION],
};

/// What the frames of a folder show.
#[derive(Debug, Serialize)]
pub struct RenderRecord {
    /// Version of the program.
    pub version: &'static str,
    /// Folder of the run.
    pub run: String,
    /// The camera path, or the position of the single camera.
    pub path: String,
    /// Number of frames.
    pub frames: usize,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Time of each frame in [0, 1].
    pub times: Vec<f64>,
    /// What the colours stand for.
    pub show: String,
    /// Direction to the light, world axes; absent if the light is the one used in training.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light: Option<[f64; 3]>,
    /// Segments shown alone; the whole scene if empty.
    pub segments: Vec<String>,
    /// Number of edits applied.
    pub edits: usize,
    /// Physical space and time of the scene, as far as its data gave them.
    pub calibration: Calibration,
}

/// What is behind the pictures of a render.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum FrameBackground {
    /// The colour that the scene was trained over.
    #[default]
    Scene,
    /// Nothing: pictures, drawn over this colour, are written with straight alpha.
    Transparent([f32; 3]),
}

impl FrameBackground {
    fn color(self) -> ColorType {
        if self == Self::Scene { ColorType::Rgb } else { ColorType::Rgba }
    }

    /// The 8-bit samples of a frame `[H, W, 4]`.
    fn samples(self, image: &[f32], camera: &Camera) -> Vec<u8> {
        match self {
            Self::Scene => to_rgb8(image, camera.width as usize, camera.height as usize).into_raw(),
            Self::Transparent(colour) => to_rgba8(image, colour),
        }
    }
}

/// Function that draws a frame from a camera and a time in [0, 1] to `[H, W, 4]`, as [`super::look::Look::frame`] or a
/// model does.
pub type DrawFrame<'a> = dyn FnMut(&Camera, f64) -> Result<Vec<f32>, RunError> + 'a;

/// Draws a frame and adds the time taken to `seconds`; returns its samples.
fn picture(
    draw: &mut DrawFrame<'_>,
    (camera, time): (&Camera, f64),
    background: FrameBackground,
    stop: &AtomicBool,
    seconds: &mut f64,
) -> Result<Vec<u8>, RunError> {
    if stop.load(Ordering::Relaxed) {
        return Err(RunError::failure("interrupted; nothing was written"));
    }
    let started = Instant::now();
    let image = draw(camera, time)?;
    *seconds += started.elapsed().as_secs_f64();
    Ok(background.samples(&image, camera))
}

fn of_animation(error: AnimationError) -> RunError {
    match error {
        AnimationError::Frame { source, .. } => match source.downcast::<RunError>() {
            Ok(error) => *error,
            Err(other) => RunError::failure(other),
        },
        AnimationError::Replace(e) => e.into(),
        e => RunError::failure(e),
    }
}

/// Returns whether `out` names a film in a single file, `.png` or `.mp4`, rather than a folder of frames.
pub fn is_film(out: &Path) -> bool {
    let named = |e: &str| out.extension().is_some_and(|found| found.eq_ignore_ascii_case(e));
    (named("png") || named("mp4")) && !out.is_dir()
}

/// Refuses a name that promises a picture or a film of a format that is not written, rather than making a folder of that
/// name.
///
/// # Errors
/// If `out` has the extension of such a format, and is not a folder already.
pub fn check_name(out: &Path) -> Result<(), RunError> {
    const OTHERS: [&str; 16] = [
        "apng", "avi", "bmp", "gif", "jpeg", "jpg", "m4v", "mkv", "mov", "mpeg", "mpg", "ppm", "tif", "tiff", "webm",
        "webp",
    ];
    let Some(extension) = out.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase) else { return Ok(()) };
    if !OTHERS.contains(&extension.as_str()) || out.is_dir() {
        return Ok(());
    }
    Err(RunError::input(format!(
        "--out {}: .{extension} files are not written; name a folder for the frames, or a film that ends in .png \
         (animated) or .mp4",
        out.display()
    )))
}

/// Draws all views into a single film (see [`is_film`]): an animated PNG, or an MP4 written by `ffmpeg`. Returns the
/// seconds spent on drawing alone.
///
/// # Errors
/// If a frame cannot be drawn or written, `ffmpeg` is missing, an MP4 was to be transparent, something else is at `out`,
/// or `stop` was set.
pub fn film(
    out: &Path,
    draw: &mut DrawFrame<'_>,
    views: &[(Camera, f64)],
    background: FrameBackground,
    fps: u16,
    stop: &AtomicBool,
) -> Result<f64, RunError> {
    let mut seconds = 0.0;
    let (width, height) = views.first().map_or((1, 1), |(c, _)| (c.width, c.height));
    let mut frames = views.iter().map(|(camera, time)| picture(draw, (camera, *time), background, stop, &mut seconds));
    if out.extension().is_some_and(|e| e.eq_ignore_ascii_case("mp4")) {
        if background != FrameBackground::Scene {
            let problem = "MP4 holds no transparency; write NAME.png or a folder, or omit --background";
            return Err(RunError::input(format!("--out {}: {problem}", out.display())));
        }
        let of_video = |e: VideoError| match e {
            VideoError::Replace(e) => e.into(),
            VideoError::Missing { .. } => RunError::input(e),
            e => RunError::failure(e),
        };
        let mut film = Mp4::create(out, (width, height), fps).map_err(of_video)?;
        frames.try_for_each(|frame| film.add(&frame?).map_err(of_video))?;
        film.finish().map_err(of_video)?;
    } else {
        try_write_apng(out, frames, (width, height), background.color(), fps).map_err(of_animation)?;
    }
    Ok(seconds)
}

/// Frames drawn one at a time into a folder that appears once all of them are there.
#[derive(Debug)]
pub struct Frames {
    out: PathBuf,
    folder: AtomicDir,
    /// Seconds spent on drawing alone.
    pub seconds: f64,
}

impl Frames {
    /// Checks that `out` is free or holds an older render, and begins a new one. Missing parent folders are created.
    ///
    /// # Errors
    /// If something else is there, or the file system reports an error.
    pub fn create(out: &Path, needed: &[&Path]) -> Result<Self, RunError> {
        Ok(Self { out: out.to_owned(), folder: AtomicDir::create_replacing(out, &KIND, needed)?, seconds: 0.0 })
    }

    /// Draws each view to a file and, if there is more than one, also to an animation at `fps` frames per second. At
    /// most two frames are in memory at any time.
    ///
    /// # Errors
    /// If a frame cannot be drawn or written, or `stop` was set.
    pub fn draw(
        &mut self,
        draw: &mut DrawFrame<'_>,
        views: &[(Camera, f64)],
        background: FrameBackground,
        fps: u16,
        stop: &AtomicBool,
    ) -> Result<(), RunError> {
        let animation = self.folder.dir().join(ANIMATION);
        let (width, height) = views.first().map_or((1, 1), |(c, _)| (c.width, c.height));
        let mut frames = views.iter().enumerate().map(|(i, view)| self.frame(draw, i, view, background, stop));
        if frames.len() < 2 {
            return frames.next().map_or(Ok(()), |frame| frame.map(drop));
        }
        try_write_apng(&animation, frames, (width, height), background.color(), fps).map_err(of_animation)
    }

    fn frame(
        &mut self,
        draw: &mut DrawFrame<'_>,
        i: usize,
        (camera, time): &(Camera, f64),
        background: FrameBackground,
        stop: &AtomicBool,
    ) -> Result<Vec<u8>, RunError> {
        let samples = picture(draw, (camera, *time), background, stop, &mut self.seconds)?;
        let path = self.folder.dir().join(format!("{i:04}.png"));
        let size = (camera.width, camera.height);
        let bytes = encode_samples(background.color(), size, &samples).map_err(RunError::failure)?;
        std::fs::write(&path, bytes).map_err(|e| RunError::failure(format!("{}: {e}", path.display())))?;
        Ok(samples)
    }

    /// Writes the record and publishes the folder, replacing an older render.
    ///
    /// # Errors
    /// If something else is there by now, or the file system reports an error.
    pub fn finish(self, record: &RenderRecord, run: &Path) -> Result<(), RunError> {
        let json = serde_json::to_vec_pretty(record).map_err(RunError::failure)?;
        let path = self.folder.dir().join(RECORD);
        std::fs::write(&path, json).map_err(|e| RunError::failure(format!("{}: {e}", self.out.display())))?;
        Ok(self.folder.commit_replacing(&KIND, &[run])?)
    }
}
