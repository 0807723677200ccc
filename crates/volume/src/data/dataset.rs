//! A dataset folder: its splits, each with frames (camera, time) and images.

use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::calibration::Calibration;
use super::camera::Camera;
use super::dataset_layout::layout_of;
use super::error::DataError;
use super::images::{ImageSet, common_size, downscaled_size, image_error};
use super::lens::check_lens;
use super::normalisation::Normalisation;
use super::transforms::{Transforms, frame_names, read_text};
use crate::files::read_regular;

/// The splits a dataset may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SplitName {
    /// Views to train on.
    Train,
    /// Views to tune on.
    Val,
    /// Views to report on.
    Test,
}

impl SplitName {
    /// All names, in the order train, val, test.
    pub const ALL: [Self; 3] = [Self::Train, Self::Val, Self::Test];

    /// The name in lower case, as in `transforms_<name>.json`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Val => "val",
            Self::Test => "test",
        }
    }

    /// The file under `root` that lists the split's views, see [`super::dataset_layout::DatasetLayout::file`]; `transforms_<name>.json` in a
    /// folder that is no dataset yet.
    pub fn json_path(self, root: &Path) -> PathBuf {
        layout_of(root).file(root, self)
    }
}

impl std::fmt::Display for SplitName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.as_str())
    }
}

impl std::str::FromStr for SplitName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|n| n.as_str() == text);
        found.ok_or_else(|| format!("`{text}` is not a split; use train, val or test"))
    }
}

/// One view.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// The image's file name without extension.
    pub name: String,
    /// The image file.
    pub path: PathBuf,
    /// The camera in the scene (see [`Normalisation`]), for the image as loaded (after downscaling).
    pub camera: Camera,
    /// Time in [0, 1].
    pub time: f64,
}

/// The views of one split; `images` holds `frames.len()` images in the same order, or none if not requested.
#[derive(Debug, Clone, PartialEq)]
pub struct Split {
    /// The split's name.
    pub name: SplitName,
    /// The views.
    pub frames: Vec<Frame>,
    /// Their images.
    pub images: ImageSet,
}

impl Split {
    /// The paths of the frames' images.
    pub fn paths(&self) -> Vec<PathBuf> {
        self.frames.iter().map(|f| f.path.clone()).collect()
    }

    /// The times of the frames, ascending, each once.
    pub fn times(&self) -> Vec<f64> {
        let mut times: Vec<f64> = self.frames.iter().map(|f| f.time).collect();
        times.sort_by(f64::total_cmp);
        times.dedup();
        times
    }

    /// The same views, with images and cameras reduced by the integer `factor`.
    ///
    /// # Errors
    /// If `factor` is 0 or does not divide the images' width and height.
    pub fn reduced(&self, factor: u32) -> Result<Self, DataError> {
        let images = self.images.downscale(factor).map_err(|mut e| {
            if let DataError::Option { path, option, .. } = &mut e {
                (*path, *option) = (self.name.json_path(Path::new("")), "speed.coarse_factor");
            }
            e
        })?;
        let reduce = |f: &Frame| Frame { camera: f.camera.downscaled(factor), ..f.clone() };
        Ok(Self { name: self.name, frames: self.frames.iter().map(reduce).collect(), images })
    }
}

/// How to open a dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OpenOptions<'a> {
    /// Integer factor by which images are reduced; 1 keeps their size.
    pub downscale: u32,
    /// The splits whose images are loaded.
    pub splits: &'a [SplitName],
    /// Maximum number of views per split, spread evenly over the file; `None` for all.
    pub max_views: Option<usize>,
}

impl Default for OpenOptions<'_> {
    fn default() -> Self {
        Self { downscale: 1, splits: &[SplitName::Train], max_views: None }
    }
}

/// An open dataset.
///
/// ```
/// use std::path::Path;
/// use volseggs_volume::data::{Dataset, OpenOptions};
/// // a folder that is no dataset: the error names what is missing
/// let error = Dataset::open(Path::new("nowhere"), &OpenOptions::default()).err().ok_or("opened")?;
/// assert!(error.to_string().contains("nowhere"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Dataset {
    /// The folder.
    pub root: PathBuf,
    /// The training split. Its frames are always present, its images only if requested.
    pub train: Split,
    /// The validation split, if requested.
    pub val: Option<Split>,
    /// The test split, if requested.
    pub test: Option<Split>,
    /// The camera of the first training view, which is kept if views are left out.
    pub first_camera: Camera,
    fingerprint: u64,
    normalisation: Normalisation,
    calibration: Calibration,
}

impl Dataset {
    /// Opens the folder `root`.
    ///
    /// # Errors
    /// A missing or invalid JSON file or image; a `downscale` that does not divide the image size.
    pub fn open(root: &Path, options: &OpenOptions<'_>) -> Result<Self, DataError> {
        let (json, contents) = SplitName::Train.views_and_contents(root)?;
        json.check_images()?;
        let path = json.path.clone();
        let all: Vec<PathBuf> = json.frames.iter().map(|f| f.image_path(root)).collect();
        let normalisation = json.normalisation();
        let read = |name: SplitName| {
            let (downscale, max_views) = (options.downscale, options.max_views);
            let wanted = options.splits.contains(&name);
            wanted.then(|| read_split(root, name, downscale, max_views, Some(normalisation))).transpose()
        };
        let train = match read(SplitName::Train)? {
            Some(split) => split,
            None => {
                let json = json.normalised(&normalisation);
                outline(root, SplitName::Train, &json, options.downscale, options.max_views)?.0
            }
        };
        let fingerprint = fingerprint(&path, &contents, &all, options.downscale)?;
        let (val, test) = (read(SplitName::Val)?, read(SplitName::Test)?);
        // a split has at least one view
        let first_camera = train.frames[0].camera.clone();
        let calibration = normalisation.calibration(Calibration::of_dataset(root)?);
        Ok(Self { root: root.to_owned(), train, val, test, first_camera, fingerprint, normalisation, calibration })
    }

    /// How the scene's coordinates, in which all cameras here are, follow from those of the dataset.
    pub fn normalisation(&self) -> Normalisation {
        self.normalisation
    }

    /// Physical space and time of the scene, as far as the dataset gives them: as `prepare` recorded them, and the
    /// [`Normalisation`].
    pub fn calibration(&self) -> Calibration {
        self.calibration.clone()
    }

    /// The splits that there are under `root`.
    pub fn present(root: &Path) -> Vec<SplitName> {
        let layout = layout_of(root);
        SplitName::ALL.into_iter().filter(|split| layout.has(root, *split)).collect()
    }

    /// The split of that name, if loaded.
    pub fn split(&self, name: SplitName) -> Option<&Split> {
        match name {
            SplitName::Train => Some(&self.train),
            SplitName::Val => self.val.as_ref(),
            SplitName::Test => self.test.as_ref(),
        }
    }

    /// 16 hexadecimal digits that identify a training set: a 64-bit FNV-1a hash of the bytes of the file of its views, the size of every training image file and the downscale factor. Independent of the
    /// other splits loaded and of the number of views.
    pub fn fingerprint(&self) -> String {
        format!("{:016x}", self.fingerprint)
    }

    /// The training times, ascending, each once.
    pub fn times(&self) -> Vec<f64> {
        self.train.times()
    }

    /// See [`scene_extent`].
    pub fn scene_extent(&self) -> f64 {
        scene_extent(&self.train.frames)
    }
}

/// 1.1 times the largest distance of a camera from their mean, as in 3DGS; learning rates of positions are relative to
/// it. If all cameras are at one position, 1.1 times their distance from the origin, since nothing would move
/// otherwise; 0 at the origin and for no frames.
pub fn scene_extent(frames: &[Frame]) -> f64 {
    let mean = frames.iter().map(|f| f.camera.position()).sum::<DVec3>() / frames.len().max(1) as f64;
    let spread = frames.iter().map(|f| f.camera.position().distance(mean)).fold(0.0, f64::max);
    // the mean of equal positions is rounded
    1.1 * if spread > 1e-9 * mean.length() { spread } else { mean.length() }
}

/// Reads one split with its images; `downscale` and `max_views` as in [`OpenOptions`]. Cameras are moved into the scene
/// by `normalisation`, for a run that of its training; by that of the dataset if it is not given.
///
/// # Errors
/// As for [`Dataset::open`].
pub fn read_split(
    root: &Path,
    name: SplitName,
    downscale: u32,
    max_views: Option<usize>,
    normalisation: Option<Normalisation>,
) -> Result<Split, DataError> {
    let json = name.views(root)?;
    json.check_images()?;
    let normalisation = normalisation.map_or_else(|| Normalisation::of_dataset(root), Ok)?;
    let json = json.normalised(&normalisation);
    let (mut split, kept) = outline(root, name, &json, downscale, max_views)?;
    let paths = split.paths();
    // with fewer views than frames, a message must still give the frame's index in the file
    split.images = ImageSet::load(&json.path, &paths, downscale).map_err(|e| renumber(e, &kept))?;
    Ok(split)
}

/// The views of one split without their images, with cameras moved into the scene by `normalisation`; only the first
/// image's size is read.
///
/// # Errors
/// As for [`Dataset::open`].
pub fn read_views(
    root: &Path,
    name: SplitName,
    downscale: u32,
    max_views: Option<usize>,
    normalisation: &Normalisation,
) -> Result<Split, DataError> {
    let json = name.views(root)?.normalised(normalisation);
    Ok(outline(root, name, &json, downscale, max_views)?.0)
}

/// Numbers the frame that `error` names as in the file, whose frames `kept` were loaded.
pub fn renumber(mut error: DataError, kept: &[usize]) -> DataError {
    if let DataError::Image { frame, .. } | DataError::MixedResolution { frame, .. } = &mut error {
        *frame = kept.get(*frame).copied().unwrap_or(*frame);
    }
    error
}

/// The split without its images, and the indices of the frames it keeps; only the first image's size is read.
fn outline(
    root: &Path,
    name: SplitName,
    json: &Transforms,
    downscale: u32,
    max_views: Option<usize>,
) -> Result<(Split, Vec<usize>), DataError> {
    let total = json.frames.len();
    let count = max_views.unwrap_or(total).min(total);
    if count == 0 {
        return Err(DataError::Option {
            path: json.path.clone(),
            option: "max_views",
            problem: "0 leaves no views".to_owned(),
            hint: "use at least 1, or omit it to use all views".to_owned(),
        });
    }
    let kept: Vec<usize> = (0..count).map(|i| i * total / count).collect();
    let first = json.frames[kept[0]].image_path(root);
    let full = common_size(&json.path, std::slice::from_ref(&first)).map_err(|e| renumber(e, &kept))?;
    check_lens(&json.path, &json.intrinsics, full)?;
    let (width, height) = downscaled_size(&json.path, full, downscale)?;
    let names = frame_names(&json.frames);
    let frames = kept
        .iter()
        .map(|i| {
            let record = &json.frames[*i];
            let camera = json.intrinsics.camera(full.0, full.1, record.camera_to_world).downscaled(downscale);
            Frame { name: names[*i].clone(), path: record.image_path(root), camera, time: record.time }
        })
        .collect();
    let images = ImageSet { width, height, pixels: Vec::new() };
    Ok((Split { name, frames, images }, kept))
}

/// 16 hexadecimal digits that identify what runs are measured on: as [`Dataset::fingerprint`], but of the views of
/// `split` and the segments' ground truth, if there is any: its text and its volumes.
///
/// # Errors
/// Views that are missing or cannot be read.
pub fn measured_fingerprint(root: &Path, split: SplitName) -> Result<String, DataError> {
    let (json, contents) = split.views_and_contents(root)?;
    let images: Vec<PathBuf> = json.frames.iter().map(|f| f.image_path(root)).collect();
    let views = fingerprint(&json.path, &contents, &images, 1)?;
    let truth = read_text(&root.join(super::truth::FILE)).unwrap_or_default();
    let mut hash = fnv1a(views, truth.as_bytes());
    // the text only names them; what cannot be read is reported where it is used
    for volume in super::Truth::read(root).map(|truth| truth.file.volumes).unwrap_or_default() {
        hash = fnv1a(
            hash,
            &read_regular(&root.join(volume.file.strip_prefix("./").unwrap_or(&volume.file))).unwrap_or_default(),
        );
    }
    Ok(format!("{hash:016x}"))
}

fn fingerprint(json: &Path, contents: &[u8], images: &[PathBuf], downscale: u32) -> Result<u64, DataError> {
    let mut hash = fnv1a(0xcbf2_9ce4_8422_2325, contents);
    for (i, path) in images.iter().enumerate() {
        let bytes = std::fs::metadata(path).map_err(|e| {
            let missing = e.kind() == std::io::ErrorKind::NotFound;
            let problem = if missing { "the image is missing".to_owned() } else { e.to_string() };
            image_error(json, path, i, problem)
        })?;
        hash = fnv1a(hash, &bytes.len().to_le_bytes());
    }
    Ok(fnv1a(hash, &downscale.to_le_bytes()))
}

/// One step of the 64-bit FNV-1a hash over `bytes`.
fn fnv1a(hash: u64, bytes: &[u8]) -> u64 {
    bytes.iter().fold(hash, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x0000_0100_0000_01b3))
}

/// The folder of the published test dataset; without it the test is skipped.
#[cfg(test)]
pub(crate) fn test_data() -> Option<PathBuf> {
    volseggs_testing::test_data("data/vortex-400", volseggs_testing::Need::Data)
}

#[cfg(test)]
#[path = "dataset_tests.rs"]
pub(crate) mod tests;
