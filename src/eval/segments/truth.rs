//! Pictures of known segments: each rendered alone with its mask, several as one, and the label images of training
//! views.

use crate::data::png::check_claim;
use crate::data::{Camera, DataError, Truth, truth};
use crate::files::read_regular;
use glam::DMat4;
use image::{DynamicImage, ImageFormat, ImageReader};
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// A segment alone, or several together, in one view.
#[derive(Clone, Debug)]
pub struct TruthFrame {
    /// The camera.
    pub camera: Camera,
    /// Time in [0, 1].
    pub time: f64,
    /// Picture and mask of each of its segments.
    images: Vec<(PathBuf, PathBuf)>,
}

/// Ground truth of one or more segments alone in a view, `[H, W]` pixels.
#[derive(Clone, Debug)]
pub struct TruthImage {
    /// RGBA with straight alpha, `[H, W, 4]`; `None` for several segments, as there is no picture of them together.
    pub rgba: Option<Vec<u8>>,
    /// Alpha in [0, 1], `[H, W]`. For several segments, this is the fraction of light that does not pass through all of
    /// them, which is correct wherever no two share a voxel.
    pub alpha: Vec<f32>,
    /// The mask `[H, W]`: whether any of the segments shows.
    pub mask: Vec<bool>,
}

/// A training view with the segment visible at each pixel.
#[derive(Clone, Debug)]
pub struct LabelledTrainingView {
    /// The view.
    pub view: truth::LabelledView,
    /// Id of the visible segment, `[H, W]`; 0 if none is.
    pub labels: Vec<u16>,
}

/// Returns the views in which segment `id` is rendered alone.
pub fn frames(truth: &Truth, id: u16) -> Vec<TruthFrame> {
    let [width, height] = truth.file.size;
    let frames = truth.file.segments.iter().filter(|s| s.id == id).flat_map(|s| &s.frames);
    frames
        .map(|f| {
            let pose = DMat4::from_cols_array_2d(&f.transform_matrix).transpose();
            TruthFrame {
                camera: Camera::from_fov_x(truth.file.camera_angle_x, width, height, pose),
                time: f.time,
                images: vec![(truth.root.join(&f.file_path), truth.root.join(&f.mask_path))],
            }
        })
        .collect()
}

/// Returns the training views at the time nearest to `time`, with their labels.
///
/// # Errors
/// If there are no label images, or one is damaged.
pub fn labelled(truth: &Truth, time: f64) -> Result<Vec<LabelledTrainingView>, DataError> {
    let views = truth.views_near(time, 0, 1)?;
    views.into_iter().map(|view| Ok(LabelledTrainingView { labels: truth.labels(&view)?, view })).collect()
}

impl TruthFrame {
    /// Adds the segments of `other` to this frame; does nothing and returns false if it is another view.
    pub(super) fn join(&mut self, other: Self) -> bool {
        let same = self.time == other.time && self.camera == other.camera;
        if same {
            self.images.extend(other.images);
        }
        same
    }

    /// Returns the number of its segments.
    #[cfg(test)]
    pub(super) fn segments(&self) -> usize {
        self.images.len()
    }

    /// Reads its pictures and masks.
    ///
    /// # Errors
    /// If a file is missing, damaged or of the wrong size.
    pub fn load(&self) -> Result<TruthImage, DataError> {
        let pixels = self.camera.width as usize * self.camera.height as usize;
        let mut out = TruthImage { rgba: None, alpha: vec![0.0; pixels], mask: vec![false; pixels] };
        for (image, mask) in &self.images {
            let rgba = self.open(image)?.into_rgba8().into_raw();
            let mask = self.open(mask)?.into_luma8();
            out.mask.iter_mut().zip(mask.as_raw()).for_each(|(all, v)| *all |= *v > 127);
            for (all, p) in out.alpha.iter_mut().zip(rgba.chunks_exact(4)) {
                *all += (1.0 - *all) * f32::from(p[3]) / 255.0;
            }
            out.rgba = (self.images.len() == 1).then_some(rgba);
        }
        Ok(out)
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
                "{}x{} pixels, but segments.json says {}x{}",
                size.0, size.1, self.camera.width, self.camera.height
            )));
        }
        let mut decoder = reader();
        decoder.no_limits();
        decoder.decode().map_err(|e| fail(e.to_string()))
    }
}
