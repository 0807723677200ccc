//! The project's own mask file: one header line, then one COCO-like annotation per line, written as they come.
//!
//! Holds the types of the lines and the writer; the reader is in `reader`, files of other programs in `coco` and
//! `png_folder`. Memory use does not grow with the number of masks.

use std::{
    io::{self, Write},
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{mask::Mask, mask::MaskError, rle, rle::RleError};
use crate::data::Camera;
use crate::files::AtomicFile;
use crate::memory::{MemoryBudget, product};

pub use super::reader::MaskReader;

/// Value of the header's `format` field.
pub const FORMAT: &str = "volseggs-masks";
/// Upper bound on the length of a line; a longer line means that the file is not a mask file.
pub(super) const LONGEST_LINE: u64 = 256 << 20;
/// Maximum number of views of a mask file: its header, a line, names each in at most 400 bytes.
pub const MAX_VIEWS: usize = LONGEST_LINE as usize / 400;
/// Version of the file format that this code writes and reads.
pub const VERSION: u32 = 1;

/// First line of a mask file: what all its masks have in common.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MaskFileHeader {
    /// Always [`FORMAT`].
    pub format: String,
    /// Always [`VERSION`].
    pub version: u32,
    /// Width of every view in pixels.
    pub width: u32,
    /// Height of every view in pixels.
    pub height: u32,
    /// Time in [0, 1] at which the model was rendered.
    pub time: f64,
    /// The views; an annotation's `image_id` counts into this list from 0.
    pub views: Vec<MaskView>,
    /// Names of the coarse segments; an annotation's `segment` counts into this list from 0.
    pub segments: Vec<String>,
    /// What made the masks, for human readers.
    pub source: String,
    /// Key of the Gaussians of each segment, see [`members_key`](crate::segment::segmentation::members_key); empty
    /// where that is not known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub members: Vec<String>,
}

impl MaskFileHeader {
    /// A header of the current format and version.
    pub fn new(
        width: u32,
        height: u32,
        time: f64,
        views: Vec<MaskView>,
        segments: Vec<String>,
        source: String,
    ) -> Self {
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            width,
            height,
            time,
            views,
            segments,
            source,
            members: Vec::new(),
        }
    }
}

/// One rendered view.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MaskView {
    /// Name of the image file.
    pub file: String,
    /// Camera-to-world matrix, `[4, 4]` row-major.
    pub camera_to_world: [f32; 16],
    /// Horizontal field of view in radians.
    pub fov_x: f32,
}

impl MaskView {
    /// Returns its camera for pictures of `width` by `height` pixels.
    pub fn camera(&self, width: u32, height: u32) -> Camera {
        let rows = self.camera_to_world.map(f64::from);
        Camera::from_fov_x(f64::from(self.fov_x), width, height, glam::DMat4::from_cols_array(&rows).transpose())
    }
}

/// One mask of one view, with its metadata.
#[derive(Debug, Clone, PartialEq)]
pub struct Annotation {
    /// Which view: index into [`MaskFileHeader::views`].
    pub image_id: u32,
    /// Which coarse segment was rendered: index into [`MaskFileHeader::segments`].
    pub segment: u32,
    /// The mask, of the header's size.
    pub mask: Mask,
    /// The source's estimate of how well the mask fits, 0 to 1.
    pub predicted_iou: f32,
    /// How little the mask changes when the source's thresholds do, 0 to 1.
    pub stability_score: f32,
    /// Size of what the mask shows, in the source's units; 0 where it is not known yet.
    pub scale: f32,
}

/// What can go wrong with mask files, the project's own and those made elsewhere.
#[derive(Debug, Error)]
pub enum StoreError {
    /// The file system reported an error.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error.
        source: io::Error,
    },
    /// A field holds an invalid value.
    #[error("{}: {field}: {problem}", path.display())]
    Field {
        /// The file.
        path: PathBuf,
        /// The field, with its line or entry.
        field: String,
        /// What is wrong and how to fix it.
        problem: String,
    },
}

impl StoreError {
    pub(super) fn field(path: &Path, field: impl Into<String>, problem: impl ToString) -> Self {
        Self::Field { path: path.to_owned(), field: field.into(), problem: problem.to_string() }
    }

    pub(super) fn io(path: &Path) -> impl Fn(io::Error) -> Self + '_ {
        |source| Self::Io { path: path.to_owned(), source }
    }
}

/// An annotation as its line holds it.
#[derive(Serialize, Deserialize)]
pub(super) struct AnnotationLine {
    pub image_id: u32,
    pub segment: u32,
    pub segmentation: CompressedMask,
    pub area: u64,
    pub bbox: [u32; 4],
    pub predicted_iou: f32,
    pub stability_score: f32,
    pub scale: f32,
}

/// COCO's compressed mask: size is `[height, width]`.
#[derive(Serialize, Deserialize)]
pub(super) struct CompressedMask {
    pub size: [u32; 2],
    pub counts: String,
}

/// What can be wrong with a compressed mask.
#[derive(Debug, Error)]
pub(super) enum CompressedMaskError {
    #[error(transparent)]
    Rle(#[from] RleError),
    #[error(transparent)]
    Mask(#[from] MaskError),
    #[error(
        "the mask is {found_width}x{found_height}, but the image is {width}x{height}; \
         make masks at the image's own size"
    )]
    Size { found_width: u32, found_height: u32, width: u32, height: u32 },
}

/// The mask of a COCO `size` and its counts, which must be of the image's size.
pub(super) fn mask_of_size(
    size: [u32; 2],
    counts: Vec<u32>,
    width: u32,
    height: u32,
) -> Result<Mask, CompressedMaskError> {
    if size != [height, width] {
        return Err(CompressedMaskError::Size { found_width: size[1], found_height: size[0], width, height });
    }
    Ok(Mask::from_counts(width, height, counts)?)
}

/// Writes a mask file line by line to a temporary name; [`MaskWriter::finish`] renames it.
///
/// Dropped without `finish`, it removes the temporary file and leaves an older file of the name unchanged.
#[derive(Debug)]
pub struct MaskWriter {
    path: PathBuf,
    out: AtomicFile,
    header: MaskFileHeader,
    written: u64,
}

impl MaskWriter {
    /// Starts a file with its header.
    ///
    /// # Errors
    /// [`StoreError::Io`]; [`StoreError::Field`] for a header of another format or version, without pixels, or with
    /// values that are not finite.
    pub fn create(path: &Path, header: MaskFileHeader) -> Result<Self, StoreError> {
        check_header(path, &header)?;
        let out = AtomicFile::create(path).map_err(StoreError::io(path))?;
        let mut writer = Self { path: path.to_owned(), out, header, written: 0 };
        let line = serde_json::to_string(&writer.header).map_err(|e| StoreError::field(path, "header", e))?;
        if line.len() as u64 + 1 >= LONGEST_LINE {
            let problem = format!("lists {} views, more than a mask file can hold", writer.header.views.len());
            return Err(StoreError::field(path, "header, views", problem));
        }
        writer.put(&line)?;
        Ok(writer)
    }

    /// Adds one annotation. Those of one view are best written together, which makes reading quicker.
    ///
    /// # Errors
    /// [`StoreError::Field`] for a view or segment that the header does not list, a mask of another size or with a
    /// wrong sum, and scores that are not finite; [`StoreError::Io`].
    pub fn write(&mut self, annotation: &Annotation) -> Result<(), StoreError> {
        let mask = &annotation.mask;
        let entry = format!("annotation {}", self.written);
        let line = AnnotationLine {
            image_id: annotation.image_id,
            segment: annotation.segment,
            segmentation: CompressedMask { size: [mask.height, mask.width], counts: rle::encode(&mask.counts) },
            area: mask.area(),
            bbox: mask.bbox(),
            predicted_iou: annotation.predicted_iou,
            stability_score: annotation.stability_score,
            scale: annotation.scale,
        };
        check_line(&self.path, &entry, &line, &self.header)?;
        mask.validate().map_err(|e| StoreError::field(&self.path, format!("{entry}, segmentation"), e))?;
        let text = serde_json::to_string(&line).map_err(|e| StoreError::field(&self.path, entry, e))?;
        self.put(&text)?;
        self.written += 1;
        Ok(())
    }

    /// Syncs the file, gives it its final name and returns the number of annotations.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub fn finish(self) -> Result<u64, StoreError> {
        self.out.commit().map_err(StoreError::io(&self.path))?;
        Ok(self.written)
    }

    fn put(&mut self, line: &str) -> Result<(), StoreError> {
        let out = &mut self.out;
        out.write_all(line.as_bytes()).and_then(|()| out.write_all(b"\n")).map_err(StoreError::io(&self.path))
    }
}

/// Checks what the type of the header does not guarantee.
pub(super) fn check_header(path: &Path, header: &MaskFileHeader) -> Result<(), StoreError> {
    let fail = |field: &str, problem: String| Err(StoreError::field(path, format!("header, {field}"), problem));
    if header.format != FORMAT {
        return fail("format", format!("is {:?}, but {FORMAT:?} is expected; this is not a mask file", header.format));
    }
    if header.version != VERSION {
        return fail("version", format!("is {}, but this program reads {VERSION}", header.version));
    }
    if header.width == 0 || header.height == 0 || header.width.checked_mul(header.height).is_none() {
        return fail("width, height", format!("{}x{} is not a valid image size", header.width, header.height));
    }
    let (members, segments) = (header.members.len(), header.segments.len());
    if members > 0 && members != segments {
        return fail("members", format!("has {members} entries, but the header lists {segments} segments"));
    }
    if !header.time.is_finite() {
        return fail("time", "is not a finite number".to_owned());
    }
    for (index, view) in header.views.iter().enumerate() {
        if !view.camera_to_world.iter().all(|value| value.is_finite()) {
            return fail(&format!("views[{index}].camera_to_world"), "holds a value that is not finite".to_owned());
        }
        if !(view.fov_x > 0.0 && view.fov_x < std::f32::consts::PI) {
            return fail(&format!("views[{index}].fov_x"), format!("is {}; it must be in (0, pi) radians", view.fov_x));
        }
    }
    Ok(())
}

/// Rejects masks of more pixels than fit into memory, whatever a damaged header says.
pub(super) fn check_memory(path: &Path, header: &MaskFileHeader, budget: MemoryBudget) -> Result<(), StoreError> {
    let (width, height) = (header.width, header.height);
    // per pixel, one byte to examine and three floats to draw, rounded up
    let bytes = product(&[width as usize, height as usize, 16]);
    let fits = budget.check(format!("masks of {width}x{height} pixels"), bytes);
    fits.map_err(|e| StoreError::field(path, "header, width, height", e))
}

/// Checks an annotation line against the header, all but the mask's counts.
pub(super) fn check_line(
    path: &Path,
    entry: &str,
    line: &AnnotationLine,
    header: &MaskFileHeader,
) -> Result<(), StoreError> {
    let fail = |field: &str, problem: String| Err(StoreError::field(path, format!("{entry}, {field}"), problem));
    let (views, segments) = (header.views.len(), header.segments.len());
    if line.image_id as usize >= views {
        return fail("image_id", format!("is {}, but the header lists {views} views", line.image_id));
    }
    if line.segment as usize >= segments {
        return fail("segment", format!("is {}, but the header lists {segments} segments", line.segment));
    }
    if line.segmentation.size != [header.height, header.width] {
        let [found_height, found_width] = line.segmentation.size;
        let (width, height) = (header.width, header.height);
        let problem = CompressedMaskError::Size { found_width, found_height, width, height };
        return fail("segmentation.size", problem.to_string());
    }
    let scores =
        [("predicted_iou", line.predicted_iou), ("stability_score", line.stability_score), ("scale", line.scale)];
    for (name, value) in scores {
        if !value.is_finite() {
            return fail(name, format!("is {value}; it must be finite"));
        }
    }
    Ok(())
}
