//! The pictures of known segments: each rendered alone with its mask, and the label images of training views.

use crate::data::png::check_claim;
use crate::data::{Camera, DataError, Truth, truth};
use crate::files::read_regular;
use glam::DMat4;
use image::{DynamicImage, ImageFormat, ImageReader};
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// A segment alone in one view.
#[derive(Clone, Debug)]
pub struct TruthFrame {
    /// The camera.
    pub camera: Camera,
    /// Time in [0, 1].
    pub time: f64,
    image: PathBuf,
    mask: PathBuf,
}

/// A picture of a segment alone, `[H, W]` pixels.
#[derive(Clone, Debug)]
pub struct TruthImage {
    /// RGBA with straight alpha, `[H, W, 4]`.
    pub rgba: Vec<u8>,
    /// Its mask `[H, W]`.
    pub mask: Vec<bool>,
}

/// A training view with the segment seen at each pixel.
#[derive(Clone, Debug)]
pub struct Labelled {
    /// The view.
    pub view: truth::LabelledView,
    /// Id of the segment seen, `[H, W]`; 0 where none is.
    pub labels: Vec<u16>,
}

/// The views in which segment `id` is rendered alone.
#[must_use]
pub fn frames(truth: &Truth, id: u16) -> Vec<TruthFrame> {
    let [width, height] = truth.file.size;
    let frames = truth.file.segments.iter().filter(|s| s.id == id).flat_map(|s| &s.frames);
    frames
        .map(|f| {
            let pose = DMat4::from_cols_array_2d(&f.transform_matrix).transpose();
            TruthFrame {
                camera: Camera::from_fov_x(truth.file.camera_angle_x, width, height, pose),
                time: f.time,
                image: truth.root.join(&f.file_path),
                mask: truth.root.join(&f.mask_path),
            }
        })
        .collect()
}

/// The training views at the time nearest to `time`, with their labels.
///
/// # Errors
/// If there are no label images, or one is damaged.
pub fn labelled(truth: &Truth, time: f64) -> Result<Vec<Labelled>, DataError> {
    let views = truth.views_near(time, 0, 1)?;
    views.into_iter().map(|view| Ok(Labelled { labels: truth.labels(&view)?, view })).collect()
}

impl TruthFrame {
    /// Reads its picture and mask.
    ///
    /// # Errors
    /// If a file is missing, damaged or of another size.
    pub fn load(&self) -> Result<TruthImage, DataError> {
        let rgba = self.open(&self.image)?.into_rgba8();
        let mask = self.open(&self.mask)?.into_luma8();
        Ok(TruthImage { rgba: rgba.into_raw(), mask: mask.as_raw().iter().map(|v| *v > 127).collect() })
    }

    fn open(&self, path: &Path) -> Result<DynamicImage, DataError> {
        let hint = "make the dataset again with `volseggs prepare`";
        let fail = |problem: String| DataError::field_error(path, None, "pixels", problem, hint);
        let bytes = read_regular(path).map_err(|e| fail(format!("cannot be read: {e}")))?;
        check_claim(&bytes, bytes.len() as u64).map_err(fail)?;
        let reader = || ImageReader::with_format(Cursor::new(&bytes), ImageFormat::Png);
        let size = reader().into_dimensions().map_err(|e| fail(e.to_string()))?;
        if size != (self.camera.width, self.camera.height) {
            return Err(fail(format!(
                "{}x{}, segments.json says {}x{}",
                size.0, size.1, self.camera.width, self.camera.height
            )));
        }
        reader().decode().map_err(|e| fail(e.to_string()))
    }
}
