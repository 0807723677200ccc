//! The ground truth of a dataset's segments: `segments.json` and the label images beside its views. `prepare` makes
//! them.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use glam::DMat4;
use image::{DynamicImage, ImageError, ImageFormat, ImageReader};
use serde::{Deserialize, Serialize};

use super::camera::Camera;
use super::dataset::SplitName;
use super::error::DataError;
use super::images::downscaled_size;
use super::lineage::{LineageEvent, ids_at};
use super::normalisation::Normalisation;
use super::png::check_claim;
use crate::files::leads_out;
use crate::name::Name;
use crate::versioned;

/// Name of the file in a dataset's folder.
pub const FILE: &str = "segments.json";

/// Times no further apart than this are the same.
const SAME_TIME: f64 = 1e-9;

/// `segments.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SegmentFile {
    /// `labels` (a label volume or a synthetic scene), `components` (connected parts) or `transfer-function` (its named
    /// ranges).
    pub source: String,
    /// Minimum alpha of a pixel in a mask or label image.
    pub mask_alpha: f32,
    /// Whole horizontal field of view of all frames, radians.
    pub camera_angle_x: f64,
    /// Width and height of all images, pixels.
    pub size: [u32; 2],
    /// Folder of label images by split, grey level = id; empty if there are none.
    pub label_images: Vec<String>,
    /// The segments, by ascending id.
    pub segments: Vec<SegmentEntry>,
    /// Volumes of ids and opacity, by ascending time; empty without views of the segments.
    pub volumes: Vec<VolumeEntry>,
    /// Ends and beginnings of segments that merge and split; empty where each id is the same object at all times.
    pub lineage: Vec<LineageEvent>,
}

impl SegmentFile {
    /// The first field that `prepare` would not write, and what is wrong with it. The file names only files of its own
    /// dataset, and names of segments become parts of paths, tables and pages.
    fn fault(&self) -> Option<(String, String)> {
        if self.size.contains(&0) {
            let [w, h] = self.size;
            return Some(("size".to_owned(), format!("{w}x{h} is not a valid image size")));
        }
        for (i, segment) in self.segments.iter().enumerate() {
            if let Err(error) = Name::new(segment.name.as_str()) {
                return Some((format!("segments[{i}].name"), error.to_string()));
            }
        }
        let frames = self.segments.iter().enumerate().flat_map(|(i, segment)| {
            segment.frames.iter().enumerate().flat_map(move |(k, frame)| {
                [("file_path", &frame.file_path), ("mask_path", &frame.mask_path)]
                    .map(|(name, path)| (format!("segments[{i}].frames[{k}].{name}"), path))
            })
        });
        let volumes = self.volumes.iter().enumerate().map(|(i, volume)| (format!("volumes[{i}].file"), &volume.file));
        let images = self.label_images.iter().enumerate().map(|(i, path)| (format!("label_images[{i}]"), path));
        let outside = frames.chain(volumes).chain(images).find(|(_, path)| leads_out(Path::new(path)));
        outside.map(|(field, path)| (field, format!("{path} is not in the folder of the dataset")))
    }
}

/// One segment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SegmentEntry {
    /// Its id in label images, from 1.
    pub id: u16,
    /// Its name, also that of its folder.
    pub name: String,
    /// Renders of it alone.
    pub frames: Vec<SegmentFrame>,
}

/// One render of a segment alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SegmentFrame {
    /// The image, RGBA with straight alpha.
    pub file_path: String,
    /// The binary mask.
    pub mask_path: String,
    /// Camera-to-world, rows, NeRF/OpenGL axes; in the dataset's coordinates in the file.
    pub transform_matrix: [[f64; 4]; 4],
    /// Time in [0, 1].
    pub time: f64,
    /// Number of pixels in the mask.
    pub pixels: usize,
}

/// One volume of ids and opacity, see [`TruthVolume`](super::truth_volume::TruthVolume).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VolumeEntry {
    /// Time in [0, 1].
    pub time: f64,
    /// The file, from the dataset's folder.
    pub file: String,
}

/// The ground truth of a dataset's segments.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// The dataset's folder.
    pub root: PathBuf,
    /// The content of its `segments.json`, with poses in the scene.
    pub file: SegmentFile,
    /// How the scene's coordinates follow from those of the dataset.
    pub normalisation: Normalisation,
}

/// A view with a label image.
#[derive(Clone, Debug, PartialEq)]
pub struct LabelledView {
    /// Split and name, as in `train/r_3`.
    pub name: String,
    /// The label image.
    pub path: PathBuf,
    /// The camera, after downscaling.
    pub camera: Camera,
    /// Time in [0, 1].
    pub time: f64,
}

impl Truth {
    /// Reads `segments.json` of the dataset at `root`.
    ///
    /// # Errors
    /// If the file is missing or invalid, or the training views cannot be read.
    pub fn read(root: &Path) -> Result<Self, DataError> {
        let path = root.join(FILE);
        let made = "only datasets that `volseggs prepare` made with --labels, --components, --synthetic or named ranges of \
                    a transfer function have it";
        let unreadable = DataError::io(&path, "read the ground truth of the segments", made);
        let text = crate::files::read_text(&path).map_err(unreadable)?;
        let again = "make the dataset again with `volseggs prepare`";
        let mut file: SegmentFile = versioned::from_json(&text).map_err(|e| DataError::of_record(&path, e, again))?;
        if let Some((field, problem)) = file.fault() {
            return Err(DataError::field_error(&path, None, &field, problem, again));
        }
        let normalisation = Normalisation::of_dataset(root)?;
        for frame in file.segments.iter_mut().flat_map(|s| &mut s.frames) {
            let pose = DMat4::from_cols_array_2d(&frame.transform_matrix).transpose();
            frame.transform_matrix = normalisation.pose(pose).transpose().to_cols_array_2d();
        }
        Ok(Self { root: root.to_owned(), file, normalisation })
    }

    /// The ids that hold at time `to` the material of the segments `ids` at time `from`, see [`ids_at`].
    pub fn ids_at(&self, ids: &[u16], from: f64, to: f64) -> Option<Vec<u16>> {
        ids_at(&self.file.lineage, ids, from, to)
    }

    /// Whether any picture at `time` shows one of the segments `ids`.
    pub fn is_pictured(&self, ids: &[u16], time: f64) -> bool {
        let own = self.file.segments.iter().filter(|s| ids.contains(&s.id));
        own.flat_map(|s| &s.frames).any(|f| (f.time - time).abs() <= SAME_TIME && f.pixels > 0)
    }

    /// The training views with a label image at the one time nearest to `time`; if they are fewer than `enough`, also
    /// the test views of that same time. Cameras are those of images reduced by the integer `downscale`.
    ///
    /// # Errors
    /// If there are no label images of training views, `downscale` does not divide the images' size, or a
    /// split is invalid.
    pub fn views_near(&self, time: f64, enough: usize, downscale: u32) -> Result<Vec<LabelledView>, DataError> {
        let mut views = self.views(SplitName::Train, downscale)?;
        let away = |v: &LabelledView| (v.time - time).abs();
        let Some(nearest) = views.iter().min_by(|a, b| away(a).total_cmp(&away(b))).map(|v| v.time) else {
            let hint = "make the dataset again with `volseggs prepare`, without --no-label-images";
            let problem = "there are no label images of training views";
            return Err(DataError::field_error(&self.root.join(FILE), None, "label_images", problem, hint));
        };
        let same = |v: &LabelledView| (v.time - nearest).abs() <= SAME_TIME;
        views.retain(same);
        if views.len() < enough && SplitName::Test.json_path(&self.root).is_file() {
            views.extend(self.views(SplitName::Test, downscale)?.into_iter().filter(same));
        }
        Ok(views)
    }

    /// The views of a split that have a label image.
    fn views(&self, split: SplitName, downscale: u32) -> Result<Vec<LabelledView>, DataError> {
        let of_split = |f: &&String| f.rsplit('/').next() == Some(split.as_str());
        let Some(folder) = self.file.label_images.iter().find(of_split) else { return Ok(Vec::new()) };
        let folder = self.root.join(folder.strip_prefix("./").unwrap_or(folder));
        let [width, height] = self.file.size;
        downscaled_size(&self.root.join(FILE), (width, height), downscale)?;
        let json = split.views(&self.root)?.normalised(&self.normalisation);
        let labelled = json.frames.iter().filter_map(|frame| {
            let path = folder.join(format!("{}.png", frame.name()));
            let camera = json.intrinsics.camera(width, height, frame.camera_to_world).downscaled(downscale);
            let name = format!("{split}/{}", frame.name());
            path.is_file().then_some(LabelledView { name, path, camera, time: frame.time })
        });
        Ok(labelled.collect())
    }

    /// The ids of a view's pixels `[H, W]` at its camera's size, 0 for none. Of the pixels that downscaling merges, the
    /// middle one counts.
    ///
    /// # Errors
    /// If the image cannot be read, is not grey, or does not have the size given in `segments.json`.
    pub fn labels(&self, view: &LabelledView) -> Result<Vec<u16>, DataError> {
        let hint = "make the dataset again with `volseggs prepare`";
        let fail = |field: &str, problem: String| DataError::field_error(&view.path, None, field, problem, hint);
        let unreadable = DataError::io(&view.path, "read the label image", hint);
        let bytes = crate::files::read_regular(&view.path).map_err(unreadable)?;
        let reader = || ImageReader::with_format(Cursor::new(&bytes), ImageFormat::Png);
        let broken = |e: ImageError| fail("pixels", format!("not a readable PNG: {e}"));
        // the size first, so that nothing is decoded because of a damaged header
        check_claim(&bytes, bytes.len() as u64).map_err(|problem| fail("pixels", problem))?;
        let (width, height) = reader().into_dimensions().map_err(broken)?;
        if [width, height] != self.file.size {
            let [w, h] = self.file.size;
            return Err(fail("size", format!("the label image is {width}x{height}, {FILE} says {w}x{h}")));
        }
        let mut decoder = reader();
        decoder.no_limits();
        let image = decoder.decode().map_err(broken)?;
        let ids: Vec<u16> = match image {
            DynamicImage::ImageLuma8(grey) => grey.into_raw().into_iter().map(u16::from).collect(),
            DynamicImage::ImageLuma16(grey) => grey.into_raw(),
            other => return Err(fail("pixels", format!("are {:?}; expected grey of 8 or 16 bits", other.color()))),
        };
        let (across, down) = (view.camera.width as usize, view.camera.height as usize);
        let factor = (width as usize).checked_div(across).unwrap_or(0);
        if factor * across != width as usize || factor * down != height as usize {
            return Err(fail("size", format!("{width}x{height} is not a multiple of the view's {across}x{down}")));
        }
        let place = |x: usize, y: usize| (y * factor + factor / 2) * width as usize + x * factor + factor / 2;
        Ok((0..down).flat_map(|y| (0..across).map(move |x| (x, y))).map(|(x, y)| ids[place(x, y)]).collect())
    }
}

#[cfg(test)]
#[path = "truth_tests.rs"]
mod tests;
