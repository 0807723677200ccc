//! Turns a time series of volumes into a dataset: images, cameras, and the ground truth of segments where labels are
//! known. One step of the volumes is held at a time; the folder appears once it is complete.
//!
//! ```text
//! views:    Fibonacci sphere distributed over the sampled steps; the spiral over all steps     f(options, seed) alone
//! series:   one step in memory at a time, as f32            files are mapped or streamed; headers checked first
//! field:    padded by its border; bricks of 4^3 cells with their distance to the next visible one
//! rays:     a step's values are integrated over the transfer function (prefix sums); gradient only where visible
//! labels:   label volumes, a scene's own, connected components (one earlier pass over all steps), or ranges of the values
//! out:      PNG with straight alpha; label images; each segment alone with its mask; ids and opacity on a coarse grid;
//!           segments.json; prepare.json
//! ```
//!
//! The volume is centred at the origin and its longest side (between outermost voxel centres) fills half the shorter side of
//! the frame (but is at most the camera's distance), as in the published data. Opacity accrues per *length* (a fraction of the
//! longest side), so a transfer function looks the same at any resolution and step. Everything is built in a temporary folder
//! and published in one step.

mod check;
mod error;
mod record;
pub mod segments;
mod shots;
mod source;
pub mod views;
mod write;

#[cfg(test)]
mod tests;
#[cfg(test)]
mod truth_tests;

pub use error::PrepareError;
pub use record::{PrepareRecord, RecordError, SourceFile};
pub use segments::{EVEN_STEPS, SegmentOptions, SegmentSteps};
pub use source::{FileLabels, PrepareSource};

use crate::data::DataError;
use crate::data::dataset::{SplitName, read_split};
use crate::data::transforms::{FrameRecord, Intrinsics, Transforms};
use crate::draw::views::view_sheet;
use crate::files::{AtomicDir, FolderKind, write_atomic};
use crate::versioned;
use crate::volume::placement::VoxelPlacement;
use crate::volume::placement::published_side;
use crate::volume::raycast::{DEFAULT_STEP, RayCaster};
use crate::volume::transfer::TransferFunction;
use check::needed;
pub use check::{LENGTHS, check};
use rayon::prelude::*;
use segments::SegmentWriter;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;
use views::{PlannedView, ViewOptions, test_views, training_views};
use write::{write_gray, write_picture, write_sheet};

/// Grows with every change to the images and cameras that the same options produce; whatever is keyed by the options
/// includes it.
pub const IMAGES: u32 = 1;
/// The same for the ground truth of segments.
pub const TRUTH: u32 = 2;

/// Minimum alpha of a pixel that belongs to a segment, in masks and label images: what is just visible on white.
pub const MASK_ALPHA: f32 = 0.05;

/// Options of [`prepare`].
#[derive(Clone, Debug)]
pub struct PrepareOptions {
    /// Cameras and sampled steps.
    pub views: ViewOptions,
    /// Length of the volume's longest side, scene units.
    pub side: f64,
    /// Distance between samples along a ray, in units of the smallest voxel spacing.
    pub step: f64,
    /// Segments shown alone, and label images.
    pub segments: SegmentOptions,
    /// Replace a dataset at the same place.
    pub replace: bool,
    /// Files read beside the volumes: a folder that holds one is not replaced.
    pub needed: Vec<PathBuf>,
}

impl Default for PrepareOptions {
    /// Images as published: 800 x 800, 30 times, 20 views each, 181 test views; with ground truth if segments are known.
    fn default() -> Self {
        Self {
            views: ViewOptions::default(),
            side: published_side(),
            step: DEFAULT_STEP,
            segments: SegmentOptions::default(),
            replace: false,
            needed: Vec::new(),
        }
    }
}

/// The folder of a dataset that was prepared here.
pub const FOLDER: FolderKind = FolderKind {
    what: "a dataset made by prepare",
    markers: &[record::FILE],
    entries: &[
        "transforms_*.json",
        "train/r_[0-9]*.png",
        "test/r_[0-9]*.png",
        "val/r_[0-9]*.png",
        "labels/*/r_[0-9]*.png",
        "segments/*/*[0-9].png",
        "segments/*/*[0-9]_mask.png",
        "segments.json",
        "volumes/step_[0-9]*.safetensors",
        "transfer-function.toml",
        "contact-sheet.png",
    ],
};

/// One image to be made, with its split and index.
struct ImageJob {
    split: SplitName,
    index: usize,
    view: PlannedView,
}

/// Number of images that [`prepare`] will make, without segments.
pub fn image_count(source: &PrepareSource, options: &PrepareOptions) -> usize {
    let times = match &options.views.times {
        views::TrainingTimes::Count(n) => source.len().min(*n),
        views::TrainingTimes::Steps(list) => list.len(),
    };
    times.saturating_mul(options.views.views_per_time).saturating_add(options.views.test_views)
}

/// The time of each step, if they are not evenly spaced.
fn uneven_times(source: &PrepareSource) -> Option<Vec<f64>> {
    let times: Vec<f64> = (0..source.len()).map(|step| source.time(step)).collect();
    let last = times.len().saturating_sub(1).max(1) as f64;
    let even = times.iter().enumerate().all(|(step, time)| (time - step as f64 / last).abs() < 1e-9);
    (!even).then_some(times)
}

/// Renders a dataset into `out`. `progress` is called after each image with the number done; setting `stop` ends it
/// early.
///
/// # Errors
/// See [`PrepareError`]; nothing is then left at `out`.
pub fn prepare(
    source: &PrepareSource,
    transfer: &TransferFunction,
    options: &PrepareOptions,
    out: &Path,
    progress: &(dyn Fn(usize) + Sync),
    stop: &AtomicBool,
) -> Result<PrepareRecord, PrepareError> {
    let started = Instant::now();
    check(source, transfer, options, out)?;
    if let Some(parent) = out.parent().filter(|p| !p.as_os_str().is_empty()) {
        std::fs::create_dir_all(parent).map_err(|e| write_error(parent, &e))?;
    }
    let folder = AtomicDir::create(out).map_err(|e| write_error(out, &e))?;
    let built = build(source, transfer, options, folder.dir(), progress, stop, started);
    let record = built.map_err(|e| e.published_as(folder.dir(), out))?;
    if options.replace {
        folder.commit_replacing(&FOLDER, &needed(source, options))?;
    } else {
        folder.commit().map_err(|e| match e.kind() {
            // another process was faster
            std::io::ErrorKind::AlreadyExists => PrepareError::Exists(out.to_owned()),
            _ => write_error(out, &e),
        })?;
    }
    Ok(record)
}

/// Makes the content of the dataset in the folder `root`.
fn build(
    source: &PrepareSource,
    transfer: &TransferFunction,
    options: &PrepareOptions,
    root: &Path,
    progress: &(dyn Fn(usize) + Sync),
    stop: &AtomicBool,
    started: Instant,
) -> Result<PrepareRecord, PrepareError> {
    let span = transfer.span(source.range()?);
    let grid = source.grid();
    let placement = VoxelPlacement::new(&grid, options.side);
    let mut jobs: Vec<ImageJob> = Vec::new();
    for (split, views) in [
        (SplitName::Train, training_views(&options.views, source.len())),
        (SplitName::Test, test_views(&options.views, source.len())),
    ] {
        write_transforms(root, split, &views, source, options)?;
        let path = root.join(split.as_str());
        std::fs::create_dir(&path).map_err(|e| write_error(&path, &e))?;
        jobs.extend(views.into_iter().enumerate().map(|(index, view)| ImageJob { split, index, view }));
    }
    let (train_views, test_views) =
        [SplitName::Train, SplitName::Test].map(|s| jobs.iter().filter(|j| j.split == s).count()).into();
    let known = source.has_segments(transfer);
    let trained: BTreeSet<usize> = jobs.iter().filter(|j| j.split == SplitName::Train).map(|j| j.view.step).collect();
    let mut segments =
        SegmentWriter::new(root, source, transfer, &options.segments, known, &jobs_of_test(&jobs), &trained);
    segments.make_folders(&[SplitName::Train, SplitName::Test]).map_err(|e| write_error(root, &e))?;

    let done = AtomicUsize::new(0);
    let (mut trained, mut empty_times) = (0, Vec::new());
    let mut load_seconds = 0.0;
    for step in 0..source.len() {
        let of_step: Vec<&ImageJob> = jobs.iter().filter(|j| j.view.step == step).collect();
        if of_step.is_empty() && !segments.wants(step) {
            continue;
        }
        let loading = Instant::now();
        let (volume, labels) = source.load(step)?;
        if let Some(labels) = &labels {
            segments.record_ids(labels);
        }
        let caster = RayCaster::new(&volume, labels, transfer, span, placement, options.step);
        drop(volume);
        load_seconds += loading.elapsed().as_secs_f64();
        let shown = of_step.par_iter().map(|job| {
            let labelled = known && options.segments.label_images;
            let shows = render(&caster, job, root, labelled, stop)?;
            progress(done.fetch_add(1, Ordering::Relaxed) + 1);
            Ok(shows && job.split == SplitName::Train)
        });
        let shown = shown.collect::<Result<Vec<bool>, PrepareError>>()?;
        if of_step.iter().any(|job| job.split == SplitName::Train) {
            trained += 1;
            if !shown.contains(&true) {
                empty_times.push(source.time(step));
            }
        }
        segments.render(step, &caster, stop)?;
    }
    if empty_times.len() == trained {
        let (source_of_values, size) = (source.describe(), grid.size());
        return Err(PrepareError::Empty { source_of_values, transfer: transfer.name.clone(), span, size });
    }
    let names = segments.finish(stop)?;
    let pictures = preview(root, 12)?;
    write_sheet(&root.join("contact-sheet.png"), &view_sheet(&pictures, 4, 320))?;
    let record = PrepareRecord {
        version: env!("CARGO_PKG_VERSION").into(),
        source: source.describe(),
        transfer_function: transfer.name.clone(),
        span,
        source_files: source.volumes().iter().map(|file| SourceFile::new(file)).collect(),
        dims: grid.dims,
        spacing: grid.spacing,
        origin: grid.origin,
        directions: grid.directions,
        side: options.side,
        half_size: placement.bounds().max.to_array(),
        calibration: source.calibration(&placement),
        steps: source.len(),
        times: uneven_times(source),
        time_values: source.time_values().map(<[f64]>::to_vec),
        step: options.step,
        train_views,
        test_views,
        size: options.views.size,
        segments: names,
        empty_times,
        seconds: started.elapsed().as_secs_f64(),
        load_seconds,
        peak_memory_bytes: crate::memory::peak_memory(),
    };
    let json = versioned::to_json_pretty(&record).map_err(|e| write_error(root, &e))?;
    for (name, bytes) in [(record::FILE, json), ("transfer-function.toml", transfer.to_toml().into_bytes())] {
        let path = root.join(name);
        write_atomic(&path, &bytes).map_err(|e| write_error(&path, &e))?;
    }
    Ok(record)
}

fn write_error(path: &Path, e: &dyn std::fmt::Display) -> PrepareError {
    PrepareError::Write { path: path.to_owned(), reason: e.to_string() }
}

fn jobs_of_test(jobs: &[ImageJob]) -> Vec<PlannedView> {
    jobs.iter().filter(|j| j.split == SplitName::Test).map(|j| j.view.clone()).collect()
}

/// Renders one image, with its label image if `labelled`, and returns whether it shows anything.
fn render(
    caster: &RayCaster,
    job: &ImageJob,
    root: &Path,
    labelled: bool,
    stop: &AtomicBool,
) -> Result<bool, PrepareError> {
    let name = format!("r_{}.png", job.index);
    let path = root.join(job.split.as_str()).join(&name);
    let camera = &job.view.camera;
    let picture = if labelled {
        let (picture, ids) = caster.render_with_labels(camera, MASK_ALPHA, stop).ok_or(PrepareError::Interrupted)?;
        write_gray(&root.join("labels").join(job.split.as_str()).join(&name), [camera.width, camera.height], &ids)?;
        picture
    } else {
        caster.render_until(camera, None, stop).ok_or(PrepareError::Interrupted)?
    };
    write_picture(&path, &picture)?;
    Ok(picture.shows())
}

/// Writes `transforms_SPLIT.json`.
fn write_transforms(
    root: &Path,
    split: SplitName,
    views: &[PlannedView],
    source: &PrepareSource,
    options: &PrepareOptions,
) -> Result<(), PrepareError> {
    let frames = views.iter().enumerate().map(|(i, view)| FrameRecord {
        file_path: format!("./{split}/r_{i}"),
        camera_to_world: view.camera.camera_to_world,
        time: source.time(view.step),
    });
    let [w, h] = options.views.size.map(f64::from);
    let intrinsics =
        Intrinsics { camera_angle_x: Some(options.views.fov_x), w: Some(w), h: Some(h), ..Intrinsics::default() };
    let path = split.json_path(root);
    Transforms { path: path.clone(), intrinsics, frames: frames.collect() }.write(&path)?;
    Ok(())
}

/// A few test views of a dataset over white, with labels, for a sheet.
///
/// # Errors
/// If the dataset cannot be read.
pub fn preview(dataset: &Path, views: usize) -> Result<Vec<(String, image::RgbImage)>, DataError> {
    let split = read_split(dataset, SplitName::Test, 1, Some(views), None)?;
    let (w, h) = (split.images.width, split.images.height);
    let mut rgb = vec![0.0; 3 * w as usize * h as usize];
    let picture = |(i, frame): (usize, &crate::data::Frame)| {
        split.images.composite(i, [1.0; 3], &mut rgb);
        let image = image::RgbImage::from_fn(w, h, |x, y| {
            let at = 3 * (y as usize * w as usize + x as usize);
            image::Rgb(std::array::from_fn(|c| (rgb[at + c] * 255.0).round() as u8))
        });
        (format!("{} t {:.2}", frame.name, frame.time), image)
    };
    Ok(split.frames.iter().enumerate().map(picture).collect())
}
