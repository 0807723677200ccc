//! Cameras of a run: those of its dataset, those a user may place, and how large a picture memory allows.

use super::saved::SavedView;
use super::{OpenRun, RunError, TrainedModel};
use crate::data::images::ImageSet;
use crate::data::paths::Lens;
use crate::data::transforms::FrameRecord;
use crate::data::{Camera, SplitName, Transforms};
use crate::export::images::to_rgb8;
use crate::memory::{MemoryBudget, product};
use glam::DVec3;
use image::RgbImage;
use schemars::JsonSchema;
use serde::Serialize;
use std::fmt;

/// Bytes needed to draw one pixel: the image in floats on the device and on the host, the workspace of splatting, and
/// the 8-bit image.
const PIXEL_BYTES: usize = 64;

/// Largest side of a picture that may be requested, pixels.
pub const SIDE: u32 = 16_384;

/// Smallest and largest distance of a camera from the centre, in half sizes of the scene: any nearer, it has no viewing
/// direction; any farther, the scene is smaller than a pixel.
const DISTANCES: [f64; 2] = [1e-6, 1e5];

/// Choice of a camera.
#[derive(Debug, Clone, PartialEq)]
pub enum ViewChoice {
    /// A camera at this point, in the coordinates of the dataset, that looks at the centre.
    At(DVec3),
    /// The camera of this test view of the dataset, counted from 0.
    Test(usize),
    /// The camera of a saved view.
    Saved {
        /// Name of its file.
        name: String,
        /// The view.
        saved: Box<SavedView>,
    },
}

/// Formats the choice as the option that makes it, such as `--view 12`.
impl fmt::Display for ViewChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::At(DVec3 { x, y, z }) => write!(f, "--camera {x},{y},{z}"),
            Self::Test(n) => write!(f, "--view {n}"),
            Self::Saved { name, .. } => write!(f, "--view {name}"),
        }
    }
}

/// Camera pose and time of a view of the dataset.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
pub struct Placed {
    /// Position of the camera, scene units.
    pub eye: [f64; 3],
    /// Point it looks at: on its axis, as far away as the scene's centre.
    pub target: [f64; 3],
    /// Up direction.
    pub up: [f64; 3],
    /// Full horizontal field of view, radians.
    pub fov: f64,
    /// Time in [0, 1].
    pub time: f64,
}

/// Checks that a picture fits into memory; `flag` is the option that set its size, such as `--size 9000`.
///
/// # Errors
/// If it does not fit; the error names the flag and the available memory.
pub fn check_lens(flag: &str, lens: Lens) -> Result<(), RunError> {
    let bytes = product(&[lens.width as usize, lens.height as usize, PIXEL_BYTES]);
    MemoryBudget::now().check(flag, bytes).map_err(RunError::input)
}

/// Checks that a scene of this half size is visible from this distance to its centre, both in the dataset's units.
fn check_distance(flag: &str, distance: f64, half_size: f64) -> Result<(), RunError> {
    let [near, far] = DISTANCES.map(|d| d * half_size);
    if (near..=far).contains(&distance) {
        return Ok(());
    }
    let problem = if distance < near { "is at the centre, at which cameras look" } else { "is too far away" };
    Err(RunError::input(format!("{flag}: {problem}; choose a distance from the centre of {near:.1e} to {far:.1e}")))
}

/// Frame `n` of a split's views, by which `what` means one.
fn frame<'a>(json: &'a Transforms, n: usize, what: &str) -> Result<&'a FrameRecord, RunError> {
    let last = json.frames.len().saturating_sub(1);
    let refused = || RunError::input(format!("{what} {n}: {} has views 0 to {last}", json.path.display()));
    json.frames.get(n).ok_or_else(refused)
}

impl OpenRun {
    /// Returns the standard deviation by which drawing widens Gaussians at the scene's centre, in pictures of the size
    /// that it was trained on, scene units: what is measured in space is what was seen.
    pub fn widening(&self) -> f64 {
        self.scene.spec.rendering().widening(self.record.surroundings.pixel())
    }
}

impl<S: TrainedModel> OpenRun<S> {
    /// Returns the camera of `choice` and, for a test view or a saved view, its time. `lens` is that of
    /// the training cameras; a saved view has its own.
    ///
    /// # Errors
    /// As for [`OpenRun::camera_at`] and [`OpenRun::test_view`], or if the picture of a saved view does not fit into
    /// memory.
    pub fn view(&self, choice: &ViewChoice, lens: Lens) -> Result<(Camera, Option<f64>), RunError> {
        match choice {
            ViewChoice::At(eye) => Ok((self.camera_at(*eye, lens)?, None)),
            ViewChoice::Test(n) => self.test_view(*n, lens).map(|(camera, time)| (camera, Some(time))),
            ViewChoice::Saved { saved, .. } => {
                let view = &saved.view;
                let [width, height] = view.size;
                check_lens(&choice.to_string(), Lens { fov_x: view.fov, width, height })?;
                Ok((view.camera(1.0), Some(view.time)))
            }
        }
    }

    /// Returns the camera at `eye` (the value of `--camera`) that looks at the centre.
    ///
    /// # Errors
    /// If it is at the centre, or too far away to see anything.
    pub fn camera_at(&self, eye: DVec3, lens: Lens) -> Result<Camera, RunError> {
        let ((centre, half_size), DVec3 { x, y, z }) = (self.model().place(), eye);
        let (eye, scale) = (self.record.normalisation.to_scene(eye), self.record.normalisation.scale);
        check_distance(&format!("--camera {x},{y},{z}"), scale * eye.distance(centre), scale * half_size)?;
        Ok(Camera::look_at(eye, centre, DVec3::Z, lens.fov_x, lens.width, lens.height))
    }

    /// Returns the camera of test view `n` of the dataset (the value of `--view`) and its time; no image is read.
    ///
    /// # Errors
    /// If the dataset's file of test views cannot be read, or has no view `n`.
    pub fn test_view(&self, n: usize, lens: Lens) -> Result<(Camera, f64), RunError> {
        let json = SplitName::Test.views(&self.dataset()?)?.normalised(&self.record.normalisation);
        let frame = frame(&json, n, "--view")?;
        Ok((json.intrinsics.camera(lens.width, lens.height, frame.camera_to_world), frame.time))
    }

    /// Returns the camera poses and times of the dataset's test views.
    ///
    /// # Errors
    /// If the dataset's file of test views cannot be read.
    pub fn test_views(&self) -> Result<Vec<Placed>, RunError> {
        let json = SplitName::Test.views(&self.dataset()?)?;
        let json = json.normalised(&self.record.normalisation);
        let Lens { width, height, .. } = self.record.surroundings.lens;
        let (centre, _) = self.model().place();
        let placed = |frame: &FrameRecord| {
            let camera = json.intrinsics.camera(width, height, frame.camera_to_world);
            let eye = camera.position();
            let target = eye + camera.forward() * eye.distance(centre).max(1e-3);
            let up = frame.camera_to_world.y_axis.truncate();
            let [eye, target, up] = [eye, target, up].map(|v| v.to_array());
            Placed { eye, target, up, fov: camera.fov_x(), time: frame.time }
        };
        Ok(json.frames.iter().map(placed).collect())
    }

    /// Returns the dataset's image of test view `n`, over the scene's background and downscaled as for training.
    ///
    /// # Errors
    /// If the file of test views cannot be read or has no view `n`, or the image cannot be read.
    pub fn test_image(&self, n: usize) -> Result<RgbImage, RunError> {
        let root = self.dataset()?;
        let json = SplitName::Test.views(&root)?;
        let frame = frame(&json, n, "view")?;
        let images = ImageSet::load(&json.path, &[frame.image_path(&root)], self.config.data.downscale)?;
        let pixels = images.composite_with_alpha(0, self.model().background());
        Ok(to_rgb8(&pixels, images.width as usize, images.height as usize))
    }

    /// Checks the distance from the centre of the cameras on a path (the value of `--radius`, in the dataset's units), and
    /// returns it in the scene's.
    ///
    /// # Errors
    /// As for [`OpenRun::camera_at`].
    pub fn radius(&self, radius: f64) -> Result<f64, RunError> {
        let scale = self.record.normalisation.scale;
        check_distance(&format!("--radius {radius}"), radius, scale * self.model().place().1)?;
        Ok(radius / scale)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::user_error::UserError;

    #[test]
    fn distances_too_near_or_too_far_are_refused() {
        let refusal = |distance: f64| check_distance("--radius R", distance, 1.5).unwrap_err();
        for (distance, word) in [(0.0, "is at the centre"), (1e-9, "is at the centre"), (1e12, "too far")] {
            let error = refusal(distance);
            assert!(error.is_input());
            assert!(error.to_string().contains(word) && error.to_string().contains("--radius R"), "{error}");
        }
        assert!(refusal(f64::NAN).to_string().starts_with("--radius R"));
        for distance in [0.01, 4.0, 1000.0] {
            check_distance("--radius R", distance, 1.5).unwrap();
        }
    }

    #[test]
    fn pictures_fit_into_memory() {
        let lens = |side| Lens { fov_x: 0.5, width: side, height: side };
        check_lens("--size 64", lens(64)).unwrap();
        let error = check_lens("--size 4294967295", lens(u32::MAX)).unwrap_err();
        assert!(error.is_input() && error.to_string().starts_with("--size 4294967295: needs about"), "{error}");
    }
}
