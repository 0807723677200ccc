//! The ground truth of segments: each rendered alone with its mask (`segments/NAME/`), label images (`labels/SPLIT/`),
//! volumes of ids (`volumes/`), and `segments.json`, which lists them.

pub use super::shots::{EVEN_STEPS, SegmentSteps};
use super::shots::{SegmentShot, shots, volume_steps};
use super::views::PlannedView;
use super::write::{write_mask, write_picture};
use super::{FileLabels, MASK_ALPHA, PrepareError, PrepareSource};
use crate::data::truth::{FILE, SegmentEntry, SegmentFile, SegmentFrame, VolumeEntry};
use crate::data::{SplitName, TruthVolume};
use crate::files::write_atomic;
use crate::versioned;
use crate::volume::grid::VolumeLabels;
use crate::volume::raycast::{RayCaster, RaycastPicture, SceneCells};
use crate::volume::transfer::TransferFunction;
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// Maximum number of cells along the longest side of a volume of ids.
pub const VOLUME_CELLS: usize = 96;

/// Which ground truth to render.
#[derive(Clone, Debug, PartialEq)]
pub struct SegmentOptions {
    /// Number of test views, evenly spaced, in which each segment is rendered alone; 0 for none, and for no volume of
    /// ids.
    pub views: usize,
    /// Steps at which they are rendered.
    pub steps: SegmentSteps,
    /// Write a label image beside every training and test image.
    pub label_images: bool,
}

impl SegmentOptions {
    /// No ground truth: no segment alone, no label image, no volume of ids.
    pub const NONE: Self = Self { views: 0, steps: SegmentSteps::Even(EVEN_STEPS), label_images: false };
}

impl Default for SegmentOptions {
    fn default() -> Self {
        Self { views: 10, steps: SegmentSteps::default(), label_images: true }
    }
}

/// Renders segments step by step.
pub(super) struct SegmentWriter<'a> {
    root: &'a Path,
    source: &'a PrepareSource,
    transfer: &'a TransferFunction,
    options: &'a SegmentOptions,
    known: bool,
    from_labels: bool,
    shots: Vec<SegmentShot>,
    volume_steps: BTreeSet<usize>,
    volumes: Vec<VolumeEntry>,
    camera_angle_x: f64,
    size: [u32; 2],
    /// All ids met so far, and those of the step met last.
    ids: BTreeSet<u16>,
    here: BTreeSet<u16>,
    entries: Vec<SegmentEntry>,
}

/// Path of a segment's image in `shot`, from the dataset's root.
fn file_path(segment: &str, shot: &SegmentShot, end: &str) -> String {
    format!("./segments/{segment}/{}{end}.png", shot.name)
}

impl<'a> SegmentWriter<'a> {
    pub fn new(
        root: &'a Path,
        source: &'a PrepareSource,
        transfer: &'a TransferFunction,
        options: &'a SegmentOptions,
        known: bool,
        test: &[PlannedView],
        trained: &BTreeSet<usize>,
    ) -> Self {
        let n = if known { options.views.min(test.len()) } else { 0 };
        let shots = shots(test, n, &options.steps, source.len(), trained);
        let volume_steps = if n > 0 { volume_steps(&options.steps, source.len(), trained) } else { BTreeSet::new() };
        let from_labels = source.label_kind().is_some();
        let ids = if known && !from_labels { (1..=transfer.segments.len() as u16).collect() } else { BTreeSet::new() };
        let first = test.first().map(|v| &v.camera);
        Self {
            root,
            source,
            transfer,
            options,
            known,
            from_labels,
            shots,
            volume_steps,
            volumes: Vec::new(),
            camera_angle_x: first.map_or(0.0, crate::data::Camera::fov_x),
            size: first.map_or([0; 2], |c| [c.width, c.height]),
            here: ids.clone(),
            ids,
            entries: Vec::new(),
        }
    }

    /// Creates the folders of label images.
    pub fn make_folders(&self, splits: &[SplitName]) -> std::io::Result<()> {
        if self.known && self.options.label_images {
            for split in splits {
                std::fs::create_dir_all(self.root.join("labels").join(split.as_str()))?;
            }
        }
        Ok(())
    }

    /// Whether a step is needed for segments alone.
    pub fn wants(&self, step: usize) -> bool {
        self.volume_steps.contains(&step) || self.shots.iter().any(|s| s.view.step == step)
    }

    /// Records which ids a step has.
    pub fn record_ids(&mut self, labels: &VolumeLabels) {
        let mut seen = vec![false; usize::from(u16::MAX) + 1];
        labels.ids.iter().for_each(|id| seen[usize::from(*id)] = true);
        self.here = (1..=u16::MAX).filter(|id| seen[usize::from(*id)]).collect();
        self.ids.extend(&self.here);
    }

    fn name(&self, id: u16) -> String {
        if self.from_labels {
            return self.source.segment_name(id);
        }
        self.transfer.segments[usize::from(id) - 1].name.clone()
    }

    /// Renders every segment of a step in its views; a segment it lacks shows nothing there, see [`Self::complete`].
    pub fn render(&mut self, step: usize, caster: &RayCaster, stop: &AtomicBool) -> Result<(), PrepareError> {
        if self.volume_steps.contains(&step) {
            self.write_volume(step, caster)?;
        }
        let shots: Vec<&SegmentShot> = self.shots.iter().filter(|s| s.view.step == step).collect();
        if shots.is_empty() {
            return Ok(());
        }
        for id in self.here.clone() {
            let name = self.name(id);
            self.make_folder(&name)?;
            let alone = caster.isolate(id);
            let frames = shots
                .par_iter()
                .map(|shot| {
                    let picture = caster.render_until(&shot.view.camera, Some(&alone), stop);
                    self.write_frame(&name, shot, &picture.ok_or(PrepareError::Interrupted)?)
                })
                .collect::<Result<Vec<_>, PrepareError>>()?;
            match self.entries.iter_mut().find(|e| e.id == id) {
                Some(entry) => entry.frames.extend(frames),
                None => self.entries.push(SegmentEntry { id, name, frames }),
            }
        }
        Ok(())
    }

    fn make_folder(&self, segment: &str) -> Result<(), PrepareError> {
        let folder = self.root.join("segments").join(segment);
        std::fs::create_dir_all(&folder)
            .map_err(|e| PrepareError::Write { path: folder.clone(), reason: e.to_string() })
    }

    /// Writes the `picture` of a segment alone and its mask, in the segment's folder.
    fn write_frame(
        &self,
        segment: &str,
        shot: &SegmentShot,
        picture: &RaycastPicture,
    ) -> Result<SegmentFrame, PrepareError> {
        let camera = &shot.view.camera;
        let mask = picture.mask(MASK_ALPHA);
        let [file_path, mask_path] = ["", "_mask"].map(|end| file_path(segment, shot, end));
        write_picture(&self.root.join(&file_path), picture)?;
        write_mask(&self.root.join(&mask_path), [camera.width, camera.height], &mask)?;
        Ok(SegmentFrame {
            file_path,
            mask_path,
            transform_matrix: camera.camera_to_world.transpose().to_cols_array_2d(),
            time: self.source.time(shot.view.step),
            pixels: mask.iter().filter(|m| **m > 0).count(),
        })
    }

    /// Completes the frames of every segment, in the order of steps and views: where a segment does not exist yet, or
    /// no longer exists, it shows nothing, and anything selected there in its place is wrong.
    fn complete(&mut self, stop: &AtomicBool) -> Result<(), PrepareError> {
        let mut shots: Vec<&SegmentShot> = self.shots.iter().collect();
        shots.sort_by_key(|shot| shot.view.step);
        let mut all = Vec::with_capacity(self.ids.len());
        for &id in &self.ids {
            let known = self.entries.iter().find(|e| e.id == id);
            let name = known.map_or_else(|| self.name(id), |entry| entry.name.clone());
            if !shots.is_empty() {
                self.make_folder(&name)?;
            }
            let frame = |shot: &&SegmentShot| {
                let path = file_path(&name, shot, "");
                match known.and_then(|entry| entry.frames.iter().find(|f| f.file_path == path)) {
                    Some(frame) => Ok(frame.clone()),
                    None if stop.load(Ordering::Relaxed) => Err(PrepareError::Interrupted),
                    None => {
                        let [width, height] = [shot.view.camera.width, shot.view.camera.height].map(|n| n as usize);
                        self.write_frame(&name, shot, &RaycastPicture::new(width, height))
                    }
                }
            };
            let frames = shots.par_iter().map(frame).collect::<Result<_, PrepareError>>()?;
            all.push(SegmentEntry { id, name, frames });
        }
        self.entries = all;
        Ok(())
    }

    /// Writes the ids and the opacity of a step on a coarse grid.
    fn write_volume(&mut self, step: usize, caster: &RayCaster) -> Result<(), PrepareError> {
        let time = self.source.time(step);
        let SceneCells { dims, spacing, origin, ids, opacity } = caster.cells(VOLUME_CELLS);
        let folder = self.root.join("volumes");
        let error =
            |path: &Path, e: &dyn std::fmt::Display| PrepareError::Write { path: path.into(), reason: e.to_string() };
        std::fs::create_dir_all(&folder).map_err(|e| error(&folder, &e))?;
        let file = format!("step_{step}.safetensors");
        let path = folder.join(&file);
        TruthVolume { time, dims, spacing, origin, ids, opacity }.write(&path).map_err(|e| error(&path, &e))?;
        self.volumes.push(VolumeEntry { time, file: format!("./volumes/{file}") });
        Ok(())
    }

    /// Writes `segments.json` if anything is known, and returns the names of the segments.
    pub fn finish(mut self, stop: &AtomicBool) -> Result<Vec<String>, PrepareError> {
        if !self.known {
            return Ok(Vec::new());
        }
        self.complete(stop)?;
        if let PrepareSource::Files { labels: FileLabels::Files { names, .. }, .. } = self.source {
            for (id, name) in names.iter().filter(|(id, _)| !self.ids.contains(id)) {
                errln!("note: --label-names {id}={name}: no voxel of the steps that were read has this label");
            }
        }
        let names = self.entries.iter().map(|e| e.name.clone()).collect();
        let splits = [SplitName::Train, SplitName::Test];
        let file = SegmentFile {
            source: self.source.label_kind().unwrap_or("transfer-function").into(),
            mask_alpha: MASK_ALPHA,
            camera_angle_x: self.camera_angle_x,
            size: self.size,
            label_images: if self.options.label_images {
                splits.map(|s| format!("./labels/{s}")).to_vec()
            } else {
                Vec::new()
            },
            segments: self.entries,
            volumes: self.volumes,
            lineage: self.source.lineage(),
        };
        let path = self.root.join(FILE);
        let error = |e: &dyn std::fmt::Display| PrepareError::Write { path: path.clone(), reason: e.to_string() };
        let json = versioned::to_json_pretty(&file).map_err(|e| error(&e))?;
        write_atomic(&path, &json).map_err(|e| error(&e))?;
        Ok(names)
    }
}
