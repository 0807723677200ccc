//! Checks that find what is wrong with a dataset before anything is rendered.

use super::{
    FOLDER, FileLabels, PrepareError, PrepareOptions, PrepareSource, SegmentOptions, SegmentSteps, image_count, views,
};
use crate::memory::{MemoryBudget, product};
use crate::name::Name;
use crate::volume::components;
use crate::volume::placement::VoxelPlacement;
use crate::volume::raycast::{LONGEST_STEP, SHORTEST_STEP};
use crate::volume::transfer::TransferFunction;
use std::collections::BTreeSet;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// Bytes of the plan per image: its camera, its entry in the JSON file, its job.
const VIEW_BYTES: usize = 2048;
/// Bytes per pixel of an image that a thread renders: colours, label, the eight bits that are written.
const PIXEL_BYTES: usize = 32;
/// Bytes per pixel of the contact sheet's images, which are read back together.
const SHEET_BYTES: usize = 120;
/// Bytes per voxel: as read, laid out for rays with its border, its label, the bricks.
const VOXEL_BYTES: usize = 11;
/// Accepted lengths in scene units.
pub const LENGTHS: RangeInclusive<f64> = 1e-6..=1e6;

/// Checks all that [`prepare`](super::prepare) refuses before it renders: the options, the source, the memory, and the
/// place of the dataset, `out`. Nothing is written.
///
/// # Errors
/// The first problem, named by its flag or in words.
pub fn check(
    source: &PrepareSource,
    transfer: &TransferFunction,
    options: &PrepareOptions,
    out: &Path,
) -> Result<(), PrepareError> {
    let wrong = |text: String| Err(PrepareError::Options(text));
    let views = &options.views;
    let steps = source.len();
    if let Some(axis) = source.grid().dims.iter().position(|n| *n < 2) {
        return wrong(format!(
            "{}: one voxel along {}; a volume needs at least 2 along each axis",
            source.describe(),
            ["x", "y", "z"][axis]
        ));
    }
    if views.size.iter().any(|n| *n == 0 || *n > 16_384) {
        return wrong(format!("size {}x{}: between 1 and 16384 pixels", views.size[0], views.size[1]));
    }
    match &views.times {
        views::TrainingTimes::Count(0) => return wrong("times 0: at least one training step is needed".into()),
        views::TrainingTimes::Steps(list) if list.is_empty() => return wrong("no training step is given".into()),
        views::TrainingTimes::Steps(list) => {
            if let Some(step) = list.iter().find(|s| **s >= steps) {
                return wrong(format!("step {step}: the series has {steps} steps, 0 to {}", steps - 1));
            }
            if let Some(pair) = list.windows(2).find(|pair| pair[1] <= pair[0]) {
                return wrong(format!(
                    "--steps: {} after {}; give each step once, in ascending order",
                    pair[1], pair[0]
                ));
            }
        }
        views::TrainingTimes::Count(_) => {}
    }
    if views.views_per_time == 0 || views.test_views == 0 {
        return wrong("at least one training view per time and one test view are needed".into());
    }
    if !(views.fov_x > 0.0 && views.fov_x < 3.1) {
        return wrong(format!("field of view {:.1} degrees: between 0 and 177", views.fov_x.to_degrees()));
    }
    for (name, length) in [("radius", views.radius), ("side", options.side)] {
        if !LENGTHS.contains(&length) {
            return wrong(format!("{name} {length:?}: a length from {:e} to {:e}", LENGTHS.start(), LENGTHS.end()));
        }
    }
    let reach = VoxelPlacement::new(&source.grid(), options.side).half.length();
    if views.radius <= reach {
        return wrong(format!("radius {}: cameras must stand outside the volume, beyond {reach:.3}", views.radius));
    }
    if !(SHORTEST_STEP..=LONGEST_STEP).contains(&options.step) {
        return wrong(format!("sample step {}: from {SHORTEST_STEP} to {LONGEST_STEP} voxels", options.step));
    }
    segment_steps(source, transfer, &options.segments)?;
    names(source, transfer)?;
    memory(source, options)?;
    if !options.replace && out.symlink_metadata().is_ok() {
        return Err(PrepareError::Exists(out.to_owned()));
    }
    FOLDER.check(out, &needed(source, options))?;
    Ok(())
}

/// Steps at which to render segments must exist, and there must be segments to render.
fn segment_steps(
    source: &PrepareSource,
    transfer: &TransferFunction,
    options: &SegmentOptions,
) -> Result<(), PrepareError> {
    if matches!(options.steps, SegmentSteps::Even(_)) {
        return Ok(());
    }
    if options.views == 0 || !source.has_segments(transfer) {
        return Err(PrepareError::Options(
            "--segment-steps: no segment is rendered; give --labels, --components or a transfer function with \
             [[segments]], and --segment-views above 0"
                .into(),
        ));
    }
    if let SegmentSteps::These(list) = &options.steps
        && let Some(step) = list.iter().find(|s| **s >= source.len())
    {
        let steps = source.len();
        return Err(PrepareError::Options(format!("--segment-steps {step}: the series has {steps} steps")));
    }
    Ok(())
}

/// Segments become folders: their names must be valid for that, and distinct.
fn names(source: &PrepareSource, transfer: &TransferFunction) -> Result<(), PrepareError> {
    let wrong = |text: String| Err(PrepareError::Options(text));
    for segment in &transfer.segments {
        if let Err(e) = Name::new(segment.name.as_str()) {
            return wrong(format!("transfer function {}: {e}", transfer.name));
        }
    }
    if let PrepareSource::Files { labels: FileLabels::Files { names, .. }, .. } = source {
        let (mut ids, mut known) = (BTreeSet::new(), BTreeSet::new());
        for (id, name) in names {
            if !ids.insert(id) || !known.insert(name) {
                return wrong(format!("label {id}={name}: give each label one name, and each name to one label"));
            }
            // the name of a label that was given none
            let other = name.strip_prefix("segment-").and_then(|n| n.parse::<u16>().ok());
            if other.is_some_and(|n| n != *id && !names.iter().any(|(i, _)| *i == n)) {
                return wrong(format!("label {id}={name}: another label has this name; choose a different one"));
            }
        }
    }
    Ok(())
}

/// Checks that the plan, the images rendered at a time and a step of the series fit into memory.
fn memory(source: &PrepareSource, options: &PrepareOptions) -> Result<(), PrepareError> {
    let (views, free) = (&options.views, MemoryBudget::now());
    let [w, h] = views.size.map(|n| n as usize);
    let plan = |count: usize| product(&[count, VIEW_BYTES]);
    free.check(format!("--test-views {}", views.test_views), plan(views.test_views))?;
    let all = image_count(source, options);
    free.check(format!("--views {} per time", views.views_per_time), plan(all))?;
    let threads = rayon::current_num_threads().min(all).max(1);
    let what = format!("--size {w}x{h}, {threads} images at a time");
    free.check(what, product(&[w, h, PIXEL_BYTES * threads]).max(product(&[w, h, SHEET_BYTES])))?;
    let dims = source.grid().dims;
    let [x, y, z] = dims;
    let parts = matches!(source, PrepareSource::Files { labels: FileLabels::Parts(_), .. });
    let bytes = if parts { VOXEL_BYTES.max(size_of::<f32>() + components::VOXEL_BYTES) } else { VOXEL_BYTES };
    free.check(format!("a volume of {x} x {y} x {z} voxels"), product(&[x, y, z, bytes]))?;
    Ok(())
}

/// The files from which the dataset is made.
pub(super) fn needed<'a>(source: &'a PrepareSource, options: &'a PrepareOptions) -> Vec<&'a Path> {
    source.files().into_iter().chain(options.needed.iter().map(PathBuf::as_path)).collect()
}
