//! `transforms_*.json` of D-NeRF/Blender datasets: values, reading, writing. Validation is in `scan`; images are not
//! read here.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::path::{Component, Path, PathBuf};

use glam::DMat4;
use serde_json::{Value, json};

use super::camera::Camera;
use super::dataset::SplitName;
use super::dataset_layout::{DatasetLayout, looked_for};
use super::error::DataError;
use super::normalisation::Normalisation;
use super::scan::{SplitScan, scan};
use crate::files::write_atomic;

/// The lens as given in the JSON; what is missing follows from the image size.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Intrinsics {
    /// Whole horizontal field of view, radians.
    pub camera_angle_x: Option<f64>,
    /// Whole vertical field of view, radians.
    pub camera_angle_y: Option<f64>,
    /// Focal length in x, pixels of a `w` wide image; preferred over `camera_angle_x`.
    pub fl_x: Option<f64>,
    /// Focal length in y, pixels of an `h` high image.
    pub fl_y: Option<f64>,
    /// Principal point x, pixels of a `w` wide image.
    pub cx: Option<f64>,
    /// Principal point y, pixels of an `h` high image.
    pub cy: Option<f64>,
    /// Width that the pixel values refer to.
    pub w: Option<f64>,
    /// Height that the pixel values refer to.
    pub h: Option<f64>,
}

impl Intrinsics {
    /// The names of the fields in the JSON, in the order of [`Self::values`].
    pub(super) const FIELDS: [&str; 8] = ["camera_angle_x", "camera_angle_y", "fl_x", "fl_y", "cx", "cy", "w", "h"];

    /// The values of [`Self::FIELDS`].
    pub(super) fn values(&self) -> [Option<f64>; 8] {
        let Self { camera_angle_x, camera_angle_y, fl_x, fl_y, cx, cy, w, h } = *self;
        [camera_angle_x, camera_angle_y, fl_x, fl_y, cx, cy, w, h]
    }

    /// The lens with these values of [`Self::FIELDS`].
    pub(super) fn from_values(values: [Option<f64>; 8]) -> Self {
        let [camera_angle_x, camera_angle_y, fl_x, fl_y, cx, cy, w, h] = values;
        Self { camera_angle_x, camera_angle_y, fl_x, fl_y, cx, cy, w, h }
    }

    /// The camera of a `width` x `height` image at `camera_to_world`; values in pixels of `w` x `h` are scaled
    /// to that size.
    pub fn camera(&self, width: u32, height: u32, camera_to_world: DMat4) -> Camera {
        let angle = self.camera_angle_x.unwrap_or(std::f64::consts::FRAC_PI_2);
        let mut camera = Camera::from_fov_x(angle, width, height, camera_to_world);
        let scale_x = self.w.map_or(1.0, |w| f64::from(width) / w);
        let scale_y = self.h.map_or(1.0, |h| f64::from(height) / h);
        if let Some(focal) = self.fl_x {
            camera.fx = focal * scale_x;
            camera.fy = focal * scale_y;
        }
        if let Some(focal) = self.fl_y {
            camera.fy = focal * scale_y;
        } else if let (None, Some(angle)) = (self.fl_x, self.camera_angle_y) {
            camera.fy = 0.5 * f64::from(height) / (0.5 * angle).tan();
        }
        camera.cx = self.cx.map_or(camera.cx, |x| x * scale_x);
        camera.cy = self.cy.map_or(camera.cy, |y| y * scale_y);
        camera
    }
}

/// One entry of `frames`.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameRecord {
    /// The image, relative to the dataset folder, as written: the extension may be absent.
    pub file_path: String,
    /// Camera-to-world `[4, 4]`, rigid, NeRF/OpenGL axes, bottom row exactly `[0, 0, 0, 1]`.
    pub camera_to_world: DMat4,
    /// Time in [0, 1].
    pub time: f64,
}

impl FrameRecord {
    /// The image file under `root`. A path without the extension of an image gets that of the file that is there: the
    /// first of `.png`, `.jpg` and `.jpeg`, in lower or upper case; `.png` if there is none.
    pub fn image_path(&self, root: &Path) -> PathBuf {
        let relative = self.file_path.strip_prefix("./").unwrap_or(&self.file_path);
        if without_extension(relative).is_some() {
            return root.join(relative);
        }
        let with = |extension: &str| root.join(format!("{relative}.{extension}"));
        let upper = EXTENSIONS.map(str::to_ascii_uppercase);
        let mut all = EXTENSIONS.into_iter().chain(upper.iter().map(String::as_str)).map(with);
        all.find(|path| path.is_file()).unwrap_or_else(|| with(EXTENSIONS[0]))
    }

    /// A short name: the file name without folder and the extension of an image.
    pub fn name(&self) -> String {
        let name = self.file_path.rsplit('/').next().unwrap_or(&self.file_path);
        without_extension(name).unwrap_or(name).to_owned()
    }
}

/// Extensions of images that are read, the preferred one first.
const EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];

/// `path` without the extension of an image; `None` if it has none.
fn without_extension(path: &str) -> Option<&str> {
    let (rest, end) = path.rsplit_once('.')?;
    EXTENSIONS.iter().any(|e| end.eq_ignore_ascii_case(e)).then_some(rest)
}

/// A name for each frame: [`FrameRecord::name`], or the path without `./` and extension for those that would share one.
pub(super) fn frame_names(records: &[FrameRecord]) -> Vec<String> {
    let short: Vec<String> = records.iter().map(FrameRecord::name).collect();
    let mut counts: HashMap<&str, usize> = HashMap::new();
    short.iter().for_each(|name| *counts.entry(name).or_default() += 1);
    let name = |(record, short): (&FrameRecord, &String)| match record.file_path.rsplit_once('/') {
        Some((folder, _)) if counts[short.as_str()] > 1 => {
            format!("{}/{short}", folder.strip_prefix("./").unwrap_or(folder))
        }
        _ => short.clone(),
    };
    records.iter().zip(&short).map(name).collect()
}

/// The first two frames of `records` (each with its index) that refer to one image file under `root`, the later one first.
pub(crate) fn same_image<'a>(
    root: &Path,
    records: impl Iterator<Item = (usize, &'a FrameRecord)>,
) -> Option<(usize, usize)> {
    let mut first: HashMap<PathBuf, usize> = HashMap::new();
    for (i, record) in records {
        match first.entry(plain(&record.image_path(root))) {
            Entry::Vacant(new) => drop(new.insert(i)),
            Entry::Occupied(known) => return Some((i, *known.get())),
        }
    }
    None
}

/// The path without `.`, and without folders that `..` immediately leaves.
fn plain(path: &Path) -> PathBuf {
    let mut out = PathBuf::new();
    for part in path.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir if out.file_name().is_some() => drop(out.pop()),
            part => out.push(part),
        }
    }
    out
}

/// The checked content of one `transforms_*.json`.
#[derive(Debug, Clone, PartialEq)]
pub struct Transforms {
    /// The file it was read from, for messages.
    pub path: PathBuf,
    /// The lens that all frames share.
    pub intrinsics: Intrinsics,
    /// The frames in the file's order; never empty after reading.
    pub frames: Vec<FrameRecord>,
}

impl Transforms {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// The first problem of the file, with file, frame and field.
    pub fn read(path: &Path) -> Result<Self, DataError> {
        Self::parse(path, &read_text(path)?)
    }

    /// Checks the text of a file; `path` is used in messages only.
    ///
    /// # Errors
    /// The first problem of the text, with file, frame and field.
    pub fn parse(path: &Path, text: &str) -> Result<Self, DataError> {
        Self::from_scan(path, scan(path, text))
    }

    /// Takes what was read of `path`, if there was no problem.
    ///
    /// # Errors
    /// The first problem.
    pub fn from_scan(path: &Path, scan: SplitScan) -> Result<Self, DataError> {
        match scan.problems.into_iter().next() {
            Some(problem) => Err(problem),
            None => Ok(Self {
                path: path.to_owned(),
                intrinsics: scan.intrinsics,
                frames: scan.frames.into_iter().flatten().collect(),
            }),
        }
    }

    /// The normalisation of a dataset with these training views, see [`Normalisation::from_poses`].
    pub fn normalisation(&self) -> Normalisation {
        Normalisation::from_poses(self.frames.iter().map(|f| f.camera_to_world))
    }

    /// The same frames with poses in the scene.
    #[must_use]
    pub fn normalised(mut self, normalisation: &Normalisation) -> Self {
        self.frames.iter_mut().for_each(|f| f.camera_to_world = normalisation.pose(f.camera_to_world));
        self
    }

    /// Rejects two frames with the same image: at most one of their poses is right.
    ///
    /// # Errors
    /// The first such pair, with the indices of both frames.
    pub fn check_images(&self) -> Result<(), DataError> {
        match same_image(self.path.parent().unwrap_or(Path::new("")), self.frames.iter().enumerate()) {
            None => Ok(()),
            Some((frame, other)) => Err(repeated(&self.path, (frame, other), &self.frames[frame].file_path)),
        }
    }

    /// The JSON text, which reads back to bit-identical values.
    pub fn to_json(&self) -> String {
        let frames: Vec<Value> = self
            .frames
            .iter()
            .map(|f| {
                let rows = f.camera_to_world.transpose().to_cols_array_2d();
                json!({ "file_path": f.file_path, "transform_matrix": rows, "time": f.time })
            })
            .collect();
        let mut top = serde_json::Map::new();
        for (field, value) in Intrinsics::FIELDS.into_iter().zip(self.intrinsics.values()) {
            if let Some(value) = value {
                top.insert(field.to_owned(), json!(value));
            }
        }
        top.insert("frames".to_owned(), Value::Array(frames));
        format!("{:#}\n", Value::Object(top))
    }

    /// Writes the file atomically, after checking that it can be read back.
    ///
    /// # Errors
    /// A value that reading would reject, or a file system error.
    pub fn write(&self, path: &Path) -> Result<(), DataError> {
        let text = self.to_json();
        Self::parse(path, &text)?;
        let hint = "check that the folder exists, is writable and has free space";
        write_atomic(path, text.as_bytes()).map_err(DataError::io(path, "write the file", hint))
    }
}

/// The layout of D-NeRF and Blender: a `transforms_*.json` for each split.
pub(super) struct TransformsLayout;

impl DatasetLayout for TransformsLayout {
    fn holds(&self) -> &'static str {
        "transforms_train.json and transforms_test.json"
    }

    fn file(&self, root: &Path, split: SplitName) -> PathBuf {
        root.join(format!("transforms_{split}.json"))
    }

    fn scan(&self, root: &Path, split: SplitName) -> Result<SplitScan, DataError> {
        let path = self.file(root, split);
        let text = read_text(&path)?;
        let found = scan(&path, &text);
        Ok(SplitScan { contents: text.into_bytes(), ..found })
    }
}

/// The error for two frames, the later one first, that refer to the image `file_path`.
pub(crate) fn repeated(json: &Path, (frame, other): (usize, usize), file_path: &str) -> DataError {
    let problem = format!("\"{file_path}\" is also the image of frame {other}");
    let hint = "each frame needs its own image; correct the path, or remove one of the two frames";
    DataError::field_error(json, Some(frame), "file_path", problem, hint)
}

/// Reads a JSON file as text, with an error that says what to do.
pub(crate) fn read_text(path: &Path) -> Result<String, DataError> {
    let hint = format!("a dataset folder holds {}; check the path", looked_for());
    let bytes = crate::files::read_regular(path).map_err(DataError::io(path, "read the file", &hint))?;
    crate::files::decode_text(bytes).map_err(|error| DataError::Syntax {
        path: path.to_owned(),
        frame: None,
        line: error.line,
        column: 1,
        problem: "the text is not UTF-8".to_owned(),
        hint: "save the file as UTF-8; it may be binary or damaged".to_owned(),
    })
}

#[cfg(test)]
#[path = "transforms_tests.rs"]
mod tests;
