//! Cameras of a run: where those of its dataset stand, where a person may place one, and how large a picture memory
//! allows.

use super::saved::SavedView;
use super::{OpenRun, RunError, Trained};
use crate::data::images::ImageSet;
use crate::data::paths::{FOV_X, Lens, RADIUS, Sphere, orbit};
use crate::data::transforms::FrameRecord;
use crate::data::{Camera, SplitName, Transforms};
use crate::export::images::to_rgb8;
use crate::memory::{Budget, product};
use glam::DVec3;
use image::RgbImage;
use serde::Serialize;
use std::fmt;

/// How far above the equator an orbit stands, radians.
const ABOVE: f64 = 20.0 * std::f64::consts::PI / 180.0;

/// Bytes that drawing takes for a pixel: the image in floats on the device and on the host, the working space of
/// splatting, and its eight bits.
const PIXEL_BYTES: usize = 64;

/// Largest side of a picture that may be asked for, pixels.
pub const SIDE: u32 = 16_384;

/// A camera may stand from so near to the centre to so far from it, in half sizes of the scene: nearer it looks nowhere,
/// farther the scene is less than a pixel.
const DISTANCES: [f64; 2] = [1e-6, 1e5];

/// The lens of a run's dataset, and where its cameras stand.
#[derive(Debug, Clone, PartialEq)]
pub struct Surroundings {
    /// The lens.
    pub lens: Lens,
    /// Where its cameras stand around the scene's centre.
    pub sphere: Sphere,
    /// What a person is to be told: that these are those of the published data, as the run's own cannot be read.
    pub note: Option<String>,
}

impl Surroundings {
    /// The same with pictures of this width in pixels, as tall as their shape asks for.
    #[must_use]
    pub fn sized(mut self, width: u32) -> Self {
        let full = self.lens;
        let height = (f64::from(full.height) * f64::from(width) / f64::from(full.width)).round().max(1.0) as u32;
        self.lens = Lens { width, height, ..full };
        self
    }

    /// `frames` cameras in a circle around the scene, a little above its equator.
    #[must_use]
    pub fn orbit(&self, frames: usize) -> Vec<Camera> {
        orbit(frames, self.sphere, ABOVE, self.lens)
    }
}

/// Which camera looks.
#[derive(Debug, Clone, PartialEq)]
pub enum ViewChoice {
    /// One at this point, world units, that looks at the centre.
    At(DVec3),
    /// That of this test view of the dataset, from 0.
    Test(usize),
    /// That of a view that was saved.
    Saved {
        /// Name of its file.
        name: String,
        /// The view.
        saved: Box<SavedView>,
    },
}

/// As it is typed, `--view 12`; the point of a camera alone.
impl fmt::Display for ViewChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::At(DVec3 { x, y, z }) => write!(f, "--camera {x},{y},{z}"),
            Self::Test(n) => write!(f, "--view {n}"),
            Self::Saved { name, .. } => write!(f, "--view {name}"),
        }
    }
}

/// Where a view of the dataset is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Placed {
    /// Where the camera stands, world units.
    pub eye: [f64; 3],
    /// What it looks at: the point of its axis that is as far away as the scene's centre.
    pub target: [f64; 3],
    /// What is up.
    pub up: [f64; 3],
    /// Whole horizontal field of view, radians.
    pub fov: f64,
    /// Time in [0, 1].
    pub time: f64,
}

/// Refuses pictures that do not fit into memory; `flag` is what says so, such as `--size 9000`.
///
/// # Errors
/// The flag, and how much there is.
pub fn check_lens(flag: &str, lens: Lens) -> Result<(), RunError> {
    let bytes = product(&[lens.width as usize, lens.height as usize, PIXEL_BYTES]);
    Budget::now().check(flag, bytes).map_err(RunError::input)
}

/// Refuses distances from the centre at which nothing can be seen of a scene of this half size.
fn check_distance(flag: &str, distance: f64, half_size: f64) -> Result<(), RunError> {
    let [near, far] = DISTANCES.map(|d| d * half_size);
    if (near..=far).contains(&distance) {
        return Ok(());
    }
    let problem = if distance < near { "is at the centre, which cameras look at" } else { "is too far away" };
    Err(RunError::input(format!("{flag}: {problem}; choose a distance from it of {near:.1e} to {far:.1e}")))
}

impl<S: Trained> OpenRun<S> {
    /// The lens of the run's dataset, and where its cameras stand around the scene; those of the published data, which
    /// [`Surroundings::note`] says, where the dataset is not there any more.
    #[must_use]
    pub fn surroundings(&self) -> Surroundings {
        let first = self.split(SplitName::Train, None, Some(1)).ok();
        let first = first.as_ref().and_then(|split| split.frames.first()).map(|f| &f.camera);
        let (width, height) = first.map_or((800, 800), |c| (c.width, c.height));
        let fov_x = first.map_or(FOV_X, Camera::fov_x);
        let note = first.is_none().then(|| {
            format!(
                "{}: no training views can be read, so that their camera is not known; a field of view of 30 degrees is \
                 taken, that of the published data",
                self.record.dataset.display()
            )
        });
        let (centre, _) = self.model().place();
        let sphere = first.map_or(Sphere { centre, radius: RADIUS }, |c| Sphere::through(c, centre));
        Surroundings { lens: Lens { fov_x, width, height }, sphere, note }
    }

    /// The camera of `choice` and, for a test view or a saved one, its time. `lens` is that of [`OpenRun::surroundings`]; a
    /// saved view has its own.
    ///
    /// # Errors
    /// As [`OpenRun::camera_at`] and [`OpenRun::test_view`]; a saved view whose picture does not fit into memory.
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

    /// The camera at `eye` (the value of `--camera`), looking at the centre.
    ///
    /// # Errors
    /// If it stands at the centre, or too far away to see anything.
    pub fn camera_at(&self, eye: DVec3, lens: Lens) -> Result<Camera, RunError> {
        let ((centre, half_size), DVec3 { x, y, z }) = (self.model().place(), eye);
        check_distance(&format!("--camera {x},{y},{z}"), eye.distance(centre), half_size)?;
        Ok(Camera::look_at(eye, centre, DVec3::Z, lens.fov_x, lens.width, lens.height))
    }

    /// The camera of test view `n` of the dataset (the value of `--view`) and its time; no picture is read.
    ///
    /// # Errors
    /// If the dataset's file of test views cannot be read, or has fewer.
    pub fn test_view(&self, n: usize, lens: Lens) -> Result<(Camera, f64), RunError> {
        let path = SplitName::Test.json_path(&self.record.dataset);
        let json = Transforms::read(&path)?;
        let Some(frame) = json.frames.get(n) else {
            let last = json.frames.len().saturating_sub(1);
            return Err(RunError::input(format!("--view {n}: {} has views 0 to {last}", path.display())));
        };
        Ok((json.intrinsics.camera(lens.width, lens.height, frame.camera_to_world), frame.time))
    }

    /// Where the test views of the dataset are.
    ///
    /// # Errors
    /// If the dataset's file of test views cannot be read.
    pub fn test_views(&self) -> Result<Vec<Placed>, RunError> {
        let json = Transforms::read(&SplitName::Test.json_path(self.dataset(None)?))?;
        let Lens { width, height, .. } = self.surroundings().lens;
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

    /// The dataset's image of test view `n`, over the scene's background, made smaller as for training.
    ///
    /// # Errors
    /// If the file of test views has fewer, or the image cannot be read.
    pub fn test_image(&self, n: usize) -> Result<RgbImage, RunError> {
        let root = self.dataset(None)?;
        let path = SplitName::Test.json_path(root);
        let json = Transforms::read(&path)?;
        let Some(frame) = json.frames.get(n) else {
            let last = json.frames.len().saturating_sub(1);
            return Err(RunError::input(format!("view {n}: {} has views 0 to {last}", path.display())));
        };
        let images = ImageSet::load(&path, &[frame.image_path(root)], self.config.data.downscale)?;
        let pixels = images.composite_with_alpha(0, self.model().background());
        Ok(to_rgb8(&pixels, images.width as usize, images.height as usize))
    }

    /// Checks the distance of cameras on a path (the value of `--radius`).
    ///
    /// # Errors
    /// As [`OpenRun::camera_at`].
    pub fn check_radius(&self, radius: f64) -> Result<(), RunError> {
        check_distance(&format!("--radius {radius}"), radius, self.model().place().1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_stand_away_from_the_centre_and_within_sight() {
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
