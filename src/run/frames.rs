//! The folder of a render: frames as they are drawn, their animation, and the record of what they show; or a film in one
//! file.

use super::RunError;
use crate::data::Camera;
use crate::export::animation::{AnimationError, try_write_apng};
use crate::export::images::{encode_png, to_rgb8};
use crate::export::video::{Mp4, VideoError};
use crate::files::{AtomicDir, FolderKind, check_file};
use image::RgbImage;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Name of the record.
const RECORD: &str = "frames.json";
/// Name of the animation.
const ANIMATION: &str = "animation.png";

/// The folder of a render, which the next one may replace.
const KIND: FolderKind = FolderKind {
    what: "a folder of rendered frames",
    markers: &[RECORD],
    entries: &["[0-9][0-9][0-9][0-9]*.png", ANIMATION],
};

/// What the frames of a folder show.
#[derive(Debug, Serialize)]
pub struct Record {
    /// Version of the program.
    pub version: &'static str,
    /// Folder of the run.
    pub run: String,
    /// The camera path, or the place of the one camera.
    pub path: String,
    /// How many there are.
    pub frames: usize,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Time of each frame in [0, 1].
    pub times: Vec<f64>,
    /// What the colours stand for.
    pub show: String,
    /// Direction to the light, world axes; absent with the light that the scene was trained in.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light: Option<[f64; 3]>,
    /// The segments shown alone; all of the scene if empty.
    pub segments: Vec<String>,
    /// Edits that are applied.
    pub edits: usize,
}

/// What draws a frame: a camera and a time in [0, 1] to `[H, W, 4]`, as [`super::look::Look::frame`] or a model does.
pub type Draw<'a> = dyn FnMut(&Camera, f64) -> Result<Vec<f32>, RunError> + 'a;

/// A frame, whose drawing adds to the `seconds`.
fn picture(
    draw: &mut Draw<'_>,
    (camera, time): (&Camera, f64),
    stop: &AtomicBool,
    seconds: &mut f64,
) -> Result<RgbImage, RunError> {
    if stop.load(Ordering::Relaxed) {
        return Err(RunError::failure("interrupted; nothing was written"));
    }
    let started = Instant::now();
    let image = draw(camera, time)?;
    *seconds += started.elapsed().as_secs_f64();
    Ok(to_rgb8(&image, camera.width as usize, camera.height as usize))
}

fn of_animation(error: AnimationError) -> RunError {
    match error {
        AnimationError::Frame { source, .. } => match source.downcast::<RunError>() {
            Ok(error) => *error,
            Err(other) => RunError::failure(other),
        },
        e => RunError::failure(e),
    }
}

/// Whether `out` names a film in one file, `.png` or `.mp4`, and not a folder of frames.
#[must_use]
pub fn is_film(out: &Path) -> bool {
    let named = |e: &str| out.extension().is_some_and(|found| found.eq_ignore_ascii_case(e));
    (named("png") || named("mp4")) && !out.is_dir()
}

/// Draws each view to one film, [`is_film`]: an animated PNG, or MP4 by `ffmpeg`. Gives the seconds of drawing alone.
///
/// # Errors
/// A frame that cannot be drawn or written, no `ffmpeg`, something else at `out`; `stop` was raised.
pub fn film(
    out: &Path,
    draw: &mut Draw<'_>,
    views: &[(Camera, f64)],
    fps: u16,
    stop: &AtomicBool,
) -> Result<f64, RunError> {
    let mut seconds = 0.0;
    let (width, height) = views.first().map_or((1, 1), |(c, _)| (c.width, c.height));
    let mut frames = views.iter().map(|(camera, time)| picture(draw, (camera, *time), stop, &mut seconds));
    if out.extension().is_some_and(|e| e.eq_ignore_ascii_case("mp4")) {
        let of_video = |e: VideoError| match e {
            VideoError::Replace(e) => e.into(),
            VideoError::Missing { .. } => RunError::input(e),
            e => RunError::failure(e),
        };
        let mut film = Mp4::create(out, (width, height), fps).map_err(of_video)?;
        frames.try_for_each(|frame| film.add(frame?.as_raw()).map_err(of_video))?;
        film.finish().map_err(of_video)?;
    } else {
        check_file(out)?;
        let frames = frames.map(|frame| frame.map(RgbImage::into_raw));
        try_write_apng(out, frames, width, height, fps).map_err(of_animation)?;
    }
    Ok(seconds)
}

/// Frames that are being drawn, one at a time, into a folder that appears when all of them are there.
#[derive(Debug)]
pub struct Frames {
    out: PathBuf,
    folder: AtomicDir,
    /// Seconds of drawing alone.
    pub seconds: f64,
}

impl Frames {
    /// Checks that `out` is free or holds an older render, and begins. Its parents are made.
    ///
    /// # Errors
    /// Something else stands there, or the file system says no.
    pub fn create(out: &Path, needed: &[&Path]) -> Result<Self, RunError> {
        Ok(Self { out: out.to_owned(), folder: AtomicDir::create_replacing(out, &KIND, needed)?, seconds: 0.0 })
    }

    /// Draws each view to a file, and more than one to an animation of `fps` frames a second as well. Two frames are in
    /// memory at most, however many there are.
    ///
    /// # Errors
    /// A frame that cannot be drawn or written; `stop` was raised.
    pub fn draw(
        &mut self,
        draw: &mut Draw<'_>,
        views: &[(Camera, f64)],
        fps: u16,
        stop: &AtomicBool,
    ) -> Result<(), RunError> {
        let animation = self.folder.dir().join(ANIMATION);
        let (width, height) = views.first().map_or((1, 1), |(c, _)| (c.width, c.height));
        let mut frames = views.iter().enumerate().map(|(i, view)| self.frame(draw, i, view, stop));
        if frames.len() < 2 {
            return frames.next().map_or(Ok(()), |frame| frame.map(drop));
        }
        try_write_apng(&animation, frames, width, height, fps).map_err(of_animation)
    }

    fn frame(
        &mut self,
        draw: &mut Draw<'_>,
        i: usize,
        (camera, time): &(Camera, f64),
        stop: &AtomicBool,
    ) -> Result<Vec<u8>, RunError> {
        let image = picture(draw, (camera, *time), stop, &mut self.seconds)?;
        let path = self.folder.dir().join(format!("{i:04}.png"));
        let bytes = encode_png(&image).map_err(RunError::failure)?;
        std::fs::write(&path, bytes).map_err(|e| RunError::failure(format!("{}: {e}", path.display())))?;
        Ok(image.into_raw())
    }

    /// Writes the record and publishes the folder, in place of an older render.
    ///
    /// # Errors
    /// Something else stands there by now, or the file system says no.
    pub fn finish(self, record: &Record, run: &Path) -> Result<(), RunError> {
        let json = serde_json::to_vec_pretty(record).map_err(RunError::failure)?;
        let path = self.folder.dir().join(RECORD);
        std::fs::write(&path, json).map_err(|e| RunError::failure(format!("{}: {e}", self.out.display())))?;
        Ok(self.folder.commit_replacing(&KIND, &[run])?)
    }
}
