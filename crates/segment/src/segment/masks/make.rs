//! Groups of Gaussians and cameras -> a mask file: draws each group alone, queries a source, writes what it finds.
//!
//! Everything about the masks themselves is left to the source.

use super::alpha::background_below;
use super::source::{MaskGroup, MaskInput, MaskSource, ScoredMask, SourceError};
use super::store::{Annotation, MaskFileHeader, MaskView, MaskWriter, StoreError};
use crate::config::types::segment::MasksConfig;
use crate::data::Camera;
use crate::model::{HostGaussians, Rendering, ToKernel};
use crate::segment::pictures::{GaussianPicture, picture, share};
use crate::segment::segmentation::members_key;
use burn::tensor::Device;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::Path;
use thiserror::Error;

/// A view to draw.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MaskShot {
    /// Its name in the mask file.
    pub file: String,
    /// Where it is seen from.
    pub camera: Camera,
}

impl MaskShot {
    /// `view-000`, `view-001`, ...
    pub fn numbered(cameras: Vec<Camera>) -> Vec<Self> {
        cameras.into_iter().enumerate().map(|(i, camera)| Self { file: format!("view-{i:03}"), camera }).collect()
    }
}

/// What to draw.
#[derive(Clone, Copy, Debug)]
pub struct MaskJob<'a> {
    /// All Gaussians of the scene at `time`.
    pub at: &'a HostGaussians,
    /// The groups to draw alone.
    pub groups: &'a [MaskGroup],
    /// The views, all of one size.
    pub shots: &'a [MaskShot],
    /// Time in [0, 1], as written to the mask file.
    pub time: f64,
    /// How the scene is drawn.
    pub rendering: Rendering,
    /// Options of the sources.
    pub config: &'a MasksConfig,
    /// The device to draw on.
    pub device: &'a Device,
}

/// Why no mask file was written. An older one is left unchanged.
#[derive(Debug, Error)]
pub enum MakeError {
    /// The cameras do not fit into one mask file.
    #[error("view {file}: {problem}")]
    Camera {
        /// The shot's name.
        file: String,
        /// What is wrong.
        problem: String,
    },
    /// Nothing to draw.
    #[error("there are no views to make masks from")]
    NoViews,
    /// A group with a Gaussian that the scene does not have.
    #[error("group {name}: Gaussian {gaussian} is listed, but the scene has only {count}")]
    Member {
        /// The group.
        name: String,
        /// Its member.
        gaussian: u32,
        /// Number of Gaussians.
        count: usize,
    },
    /// The source failed.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The file cannot be written.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// `progress` asked to stop.
    #[error("stopped; any existing masks are unchanged")]
    Stopped,
}

impl MaskJob<'_> {
    /// Checks the job and returns width and height of all pictures, pixels.
    ///
    /// # Errors
    /// [`MakeError::NoViews`]; [`MakeError::Camera`] for cameras of different sizes and those that a mask file, which
    /// stores only the horizontal field of view, cannot represent; [`MakeError::Member`].
    pub fn check(&self) -> Result<[u32; 2], MakeError> {
        let first = &self.shots.first().ok_or(MakeError::NoViews)?.camera;
        for MaskShot { file, camera: c } in self.shots {
            let fail = |problem: String| Err(MakeError::Camera { file: file.clone(), problem });
            if (c.width, c.height) != (first.width, first.height) {
                return fail(format!(
                    "{}x{} pixels, but the first view has {}x{}",
                    c.width, c.height, first.width, first.height
                ));
            }
            let off = (c.cx - 0.5 * f64::from(c.width)).abs().max((c.cy - 0.5 * f64::from(c.height)).abs());
            if off > 0.01 || (c.fx - c.fy).abs() > 1e-4 * c.fx {
                return fail("a mask file needs square pixels and a centred principal point".to_owned());
            }
        }
        let count = self.at.len();
        for group in self.groups {
            if let Some(&gaussian) = group.members.iter().find(|m| **m as usize >= count) {
                return Err(MakeError::Member { name: group.name.clone(), gaussian, count });
            }
        }
        Ok([first.width, first.height])
    }

    fn header(&self, [width, height]: [u32; 2], source: &dyn MaskSource) -> MaskFileHeader {
        let views = self.shots.iter().map(|s| MaskView {
            file: s.file.clone(),
            camera_to_world: s.camera.camera_to_world.transpose().to_cols_array().map(|v| v as f32),
            fov_x: s.camera.fov_x() as f32,
        });
        let names = self.groups.iter().map(|g| g.name.clone()).collect();
        let header = MaskFileHeader::new(width, height, self.time, views.collect(), names, source.name().to_owned());
        MaskFileHeader { members: self.groups.iter().map(|g| members_key(&g.members)).collect(), ..header }
    }

    /// Where `members` are in front in the whole scene, and not background when drawn alone; `picture` shows them alone.
    fn front(&self, members: &[u32], picture: &GaussianPicture, camera: &Camera) -> Vec<bool> {
        let share = share(self.at, members, self.rendering.seen_by(camera.to_kernel()), self.device);
        let below = background_below(picture, self.config) as f32;
        share
            .iter()
            .zip(picture.rgba.chunks_exact(4))
            .map(|(s, p)| *s > self.config.front_share && p[3] > below)
            .collect()
    }
}

/// Draws each group alone from each view, queries `source` for masks and writes them to `path` as they come. Returns
/// the number of masks. The file is bit-identical for any number of threads.
///
/// `progress` is called for each view of each group in order, with the masks found, and returns whether to continue.
///
/// # Errors
/// As [`MakeError`].
pub fn make_masks(
    job: &MaskJob<'_>,
    source: &dyn MaskSource,
    path: &Path,
    mut progress: impl FnMut(&MaskInput<'_>, &[ScoredMask]) -> bool,
) -> Result<u64, MakeError> {
    let size = job.check()?;
    let mut writer = MaskWriter::create(path, job.header(size, source))?;
    let batch = source.batch_size().max(1);
    for (group, MaskGroup { members, .. }) in job.groups.iter().enumerate() {
        let alone = job.at.subset(members);
        // pictures one after the other (each uses all threads), then their masks in parallel, a few at a time
        for (start, shots) in (0..).step_by(batch).zip(job.shots.chunks(batch)) {
            let draw = |shot: &MaskShot| {
                let drawn = picture(&alone, job.rendering.seen_by(shot.camera.to_kernel()), job.device);
                let front = source.needs_front().then(|| job.front(members, &drawn, &shot.camera));
                (drawn, front)
            };
            let drawn: Vec<(GaussianPicture, Option<Vec<bool>>)> = shots.iter().map(draw).collect();
            let see = |(i, (picture, front)): (usize, &'_ (GaussianPicture, Option<Vec<bool>>))| {
                let found = source.find(&MaskInput { view: start + i, group, picture, front: front.as_deref() })?;
                Ok::<_, SourceError>(found)
            };
            let all = drawn.par_iter().enumerate().map(see).collect::<Vec<_>>();
            for (i, ((picture, front), found)) in drawn.iter().zip(all).enumerate() {
                let found = found?;
                if !progress(&MaskInput { view: start + i, group, picture, front: front.as_deref() }, &found) {
                    return Err(MakeError::Stopped);
                }
                for f in found {
                    writer.write(&Annotation {
                        image_id: (start + i) as u32,
                        segment: group as u32,
                        mask: f.mask,
                        predicted_iou: f.predicted_iou,
                        stability_score: f.stability_score,
                        scale: 0.0,
                    })?;
                }
            }
        }
    }
    Ok(writer.finish()?)
}

#[cfg(test)]
#[path = "make_tests.rs"]
mod tests;
