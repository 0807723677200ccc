//! Runs every check of a dataset folder and gathers one report: it never stops at the first problem and changes
//! nothing. Pictures are in `layout`.

use std::path::{Path, PathBuf};

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::dataset::{Dataset, SplitName};
use super::dataset_layout::layout_of;
use super::images::{decode, size};
use super::inspect_views::{cameras, times};
use super::normalisation::Normalisation;
use super::scan::{ROTATION_TOLERANCE, SplitScan};
use super::transforms::{FrameRecord, repeated, same_image};
use crate::files::leads_out;

/// Maximum number of problems in a check's detail; the report's `problems` has them all.
const MAX_SHOWN: usize = 5;

/// The result of one check.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DatasetCheck {
    /// Its name, as in `train: json`.
    pub name: String,
    /// Whether it passed.
    pub ok: bool,
    /// What was found, in words.
    pub detail: String,
}

/// Numbers of one split.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SplitFacts {
    /// `train`, `val` or `test`.
    pub name: String,
    /// Frames in the JSON file.
    pub frames: usize,
    /// Width and height of the first readable image, pixels.
    pub resolution: Option<[u32; 2]>,
    /// Number of missing images.
    pub missing_images: usize,
    /// Distinct times.
    pub times: usize,
    /// First and last time.
    pub time_range: Option<[f64; 2]>,
    /// Largest step between neighbouring times over the mean step; 1 for evenly spaced.
    pub time_step_ratio: Option<f64>,
    /// Minimum and maximum number of views per time.
    pub views_per_time: Option<[usize; 2]>,
    /// Focal lengths x and y, pixels of the images as stored.
    pub focal: Option<[f64; 2]>,
    /// Principal point, pixels of the images as stored.
    pub principal_point: Option<[f64; 2]>,
    /// Horizontal field of view, degrees.
    pub fov_x_degrees: Option<f64>,
    /// Largest entry of `|R^T R - I|` over all poses.
    pub orthonormality_error: f64,
    /// The point the cameras look at.
    pub look_at: Option<[f64; 3]>,
    /// Root-mean-square distance of the optical axes from it.
    pub look_at_error: Option<f64>,
    /// Smallest and largest distance of a camera from that point (from the origin if there is none).
    pub camera_radius: Option<[f64; 2]>,
    /// Fraction of pixels with alpha above 0, mean over the readable images.
    pub alpha_coverage: Option<f64>,
    /// Fraction of pixels with full alpha.
    pub alpha_opaque: Option<f64>,
}

/// What a dataset folder holds and what is wrong with it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct DatasetReport {
    /// The folder.
    pub root: PathBuf,
    /// The checks, in a fixed order.
    pub checks: Vec<DatasetCheck>,
    /// Numbers per split.
    pub splits: Vec<SplitFacts>,
    /// Every single problem, with file, frame and field.
    pub problems: Vec<String>,
    /// Remarks that are not problems.
    pub notes: Vec<String>,
}

impl DatasetReport {
    /// Whether all checks passed.
    pub fn ok(&self) -> bool {
        self.checks.iter().all(|c| c.ok)
    }

    pub(super) fn check(&mut self, split: &str, what: &str, ok: bool, detail: impl Into<String>) {
        self.checks.push(DatasetCheck { name: format!("{split}: {what}"), ok, detail: detail.into() });
    }

    /// A check that fails with `problems`, or passes with `fine`.
    pub(super) fn check_list(&mut self, split: &str, what: &str, problems: Vec<String>, fine: impl Into<String>) {
        let detail = if problems.is_empty() { fine.into() } else { summary(&problems) };
        self.check(split, what, problems.is_empty(), detail);
        self.problems.extend(problems);
    }
}

/// Checks the dataset folder `root`: JSON, images, times, lens and poses of every split.
pub fn inspect(root: &Path) -> DatasetReport {
    let mut report = DatasetReport { root: root.to_owned(), ..DatasetReport::default() };
    let (layout, present) = (layout_of(root), Dataset::present(root));
    let found = present.iter().map(|n| n.as_str()).collect::<Vec<_>>().join(", ");
    let lacking = SplitName::ALL.iter().filter(|n| **n != SplitName::Val && !present.contains(n));
    let problems = lacking.map(|n| format!("{} is missing", n.json_path(root).display())).collect();
    report.check_list("dataset", "splits", problems, format!("found {found}"));
    let mut read: Vec<(SplitName, Vec<u8>)> = Vec::new();
    for name in present {
        match layout.scan(root, name) {
            Ok(scan) => {
                if let Some((other, _)) = read.iter().find(|(_, contents)| *contents == scan.contents) {
                    report.notes.push(format!("{name} is byte-for-byte identical to {other}"));
                }
                inspect_split(&mut report, root, name, &scan);
                read.push((name, scan.contents));
            }
            Err(problem) => report.check_list(name.as_str(), "json", vec![problem.to_string()], ""),
        }
    }
    report
}

fn inspect_split(report: &mut DatasetReport, root: &Path, name: SplitName, scan: &SplitScan) {
    let path = name.json_path(root);
    let split = name.as_str();
    let mut facts = SplitFacts { name: split.to_owned(), frames: scan.frames.len(), ..SplitFacts::default() };
    let problems: Vec<String> = scan.problems.iter().map(ToString::to_string).collect();
    report.check_list(split, "json", problems, format!("{} frames", scan.frames.len()));
    facts.orthonormality_error = scan.orthonormality_error;
    report.check(
        split,
        "poses",
        scan.orthonormality_error <= ROTATION_TOLERANCE,
        format!("rotations are orthonormal to {:.1e} (at most {ROTATION_TOLERANCE:.0e})", scan.orthonormality_error),
    );
    let records: Vec<(usize, &FrameRecord)> =
        scan.frames.iter().enumerate().filter_map(|(i, f)| f.as_ref().map(|f| (i, f))).collect();
    let outside = |(_, record): &&(usize, &FrameRecord)| leads_out(Path::new(&record.file_path));
    if let Some((frame, record)) = records.iter().find(outside) {
        let count = records.iter().filter(outside).count();
        report.notes.push(format!(
            "{}: {count} images are not in the folder of the dataset, the first is {} (frame {frame})",
            path.display(),
            record.file_path
        ));
    }
    images(report, &mut facts, root, &path, &records);
    times(report, &mut facts, &records);
    cameras(report, &mut facts, &path, scan, &records);
    let normalisation = Normalisation::from_poses(records.iter().map(|(_, record)| record.camera_to_world));
    if name == SplitName::Train && !normalisation.is_none() {
        let Normalisation { centre, scale } = normalisation;
        let DVec3 { x, y, z } = centre;
        report.notes.push(format!(
            "the cameras are of unusual distance or place, so ({x}, {y}, {z}) is subtracted from all positions, which are \
             then divided by {scale}; outputs are in the dataset's own units"
        ));
    }
    report.splits.push(facts);
}

/// Decodes every image once, in parallel, keeping only counts.
fn images(
    report: &mut DatasetReport,
    facts: &mut SplitFacts,
    root: &Path,
    json: &Path,
    records: &[(usize, &FrameRecord)],
) {
    let paths: Vec<PathBuf> = records.iter().map(|(_, r)| r.image_path(root)).collect();
    let twice = same_image(root, records.iter().copied());
    let twice = twice.and_then(|pair| Some((pair, &records.iter().find(|(i, _)| *i == pair.0)?.1.file_path)));
    let twice = twice.map(|(pair, file_path)| repeated(json, pair, file_path).to_string());
    report.check_list(&facts.name.clone(), "images differ", twice.into_iter().collect(), "each frame has its own");
    let looked: Vec<Result<([u64; 4], bool), String>> = paths.par_iter().map(|p| count_alpha(p)).collect();
    let (mut missing, mut broken, mut odd, mut mixed) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut seen, mut opaque, mut pixels) = (0, 0, 0);
    let mut first: Option<([u32; 2], usize, bool)> = None;
    for (k, result) in looked.into_iter().enumerate() {
        let place = format!("{} (frame {} of {})", paths[k].display(), records[k].0, json.display());
        match result {
            Err(problem) if !paths[k].exists() => missing.push(format!("{place}: {problem}")),
            Err(problem) => broken.push(format!("{place}: {problem}")),
            Ok(([w, h, some, full], alpha)) => {
                let size = [w as u32, h as u32];
                let (expected, at, first_alpha) = *first.get_or_insert((size, k, alpha));
                if size != expected {
                    let (a, b) = (paths[at].display(), expected);
                    odd.push(format!("{place} is {w}x{h}, but {a} is {}x{}", b[0], b[1]));
                }
                if alpha != first_alpha {
                    let (has, other) = if alpha { ("an", "none") } else { ("no", "one") };
                    mixed.push(format!("{place} has {has} alpha channel, but {} has {other}", paths[at].display()));
                }
                (seen, opaque, pixels) = (seen + some, opaque + full, pixels + w * h);
            }
        }
    }
    facts.missing_images = missing.len();
    facts.resolution = first.map(|(size, ..)| size);
    let n = paths.len();
    let size = first.map_or_else(|| "no image could be read".to_owned(), |([w, h], ..)| format!("{w}x{h} pixels"));
    let name = facts.name.clone();
    report.check_list(&name, "images present", missing, format!("{n} of {n}"));
    report.check_list(&name, "images readable", broken, "all decode");
    report.check_list(&name, "resolution", odd, size);
    let channels = if first.is_some_and(|(.., alpha)| alpha) { "all have alpha" } else { "none has alpha" };
    report.check_list(&name, "channels", mixed, channels);
    if pixels > 0 {
        let (some, full) = (seen as f64 / pixels as f64, opaque as f64 / pixels as f64);
        (facts.alpha_coverage, facts.alpha_opaque) = (Some(some), Some(full));
        let shares = format!("{:.1} % of the pixels are not empty, {:.1} % opaque", 100.0 * some, 100.0 * full);
        let hint = match () {
            () if some <= 0.0 => "; every image is empty",
            () if full >= 1.0 => "; no transparency: the bounding box of the data cannot be derived from the images",
            () => "",
        };
        // images without transparency can be trained on
        report.check(&name, "alpha", some > 0.0, shares + hint);
    }
}

/// Width, height, pixels with some alpha, pixels with full alpha; and whether there is an alpha channel.
fn count_alpha(path: &Path) -> Result<([u64; 4], bool), String> {
    size(path)?;
    let (image, alpha) = decode(path)?;
    let (mut some, mut full) = (0, 0);
    for pixel in image.as_raw().chunks_exact(4) {
        some += u64::from(pixel[3] > 0);
        full += u64::from(pixel[3] == 255);
    }
    Ok(([u64::from(image.width()), u64::from(image.height()), some, full], alpha))
}

fn summary(problems: &[String]) -> String {
    let mut text = problems[..problems.len().min(MAX_SHOWN)].join("; ");
    if problems.len() > MAX_SHOWN {
        text += &format!("; and {} more", problems.len() - MAX_SHOWN);
    }
    text
}

#[cfg(test)]
#[path = "inspect_tests.rs"]
mod tests;
