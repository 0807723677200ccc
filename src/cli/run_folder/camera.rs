//! Cameras that a person places: where they may stand, and how large a picture memory allows.

use super::super::CliError;
use super::RunFolder;
use crate::data::paths::Lens;
use crate::data::{Camera, SplitName, Transforms};
use crate::memory::{Budget, product};
use glam::DVec3;

/// Bytes that drawing takes for a pixel: the image in floats on the device and on the host, the working space of
/// splatting, and its eight bits.
const PIXEL_BYTES: usize = 64;

/// A camera may stand from so near to the centre to so far from it, in half sizes of the scene: nearer it looks nowhere,
/// farther the scene is less than a pixel.
const DISTANCES: [f64; 2] = [1e-6, 1e5];

/// Refuses pictures that do not fit into memory; `flag` is what says so, such as `--size 9000`.
pub(in crate::cli) fn check_lens(flag: &str, lens: Lens) -> Result<(), CliError> {
    let bytes = product(&[lens.width as usize, lens.height as usize, PIXEL_BYTES]);
    Budget::now().check(flag, bytes).map_err(CliError::input)
}

/// Refuses distances from the centre at which nothing can be seen of a scene of this half size.
fn check_distance(flag: &str, distance: f64, half_size: f64) -> Result<(), CliError> {
    let [near, far] = DISTANCES.map(|d| d * half_size);
    if (near..=far).contains(&distance) {
        return Ok(());
    }
    let problem = if distance < near { "is at the centre, which cameras look at" } else { "is too far away" };
    Err(CliError::input(format!("{flag}: {problem}; choose a distance from it of {near:.1e} to {far:.1e}")))
}

impl RunFolder {
    /// The camera at `eye` (the value of `--camera`), looking at the centre.
    ///
    /// # Errors
    /// If it stands at the centre, or too far away to see anything.
    pub(in crate::cli) fn camera_at(&self, eye: DVec3, lens: Lens) -> Result<Camera, CliError> {
        let (centre, DVec3 { x, y, z }) = (self.scene.spec.centre(), eye);
        check_distance(&format!("--camera {x},{y},{z}"), eye.distance(centre), self.half_size())?;
        Ok(Camera::look_at(eye, centre, DVec3::Z, lens.fov_x, lens.width, lens.height))
    }

    /// The camera of test view `n` of the dataset (the value of `--view`) and its time; no picture is read.
    ///
    /// # Errors
    /// If the dataset's file of test views cannot be read, or has fewer.
    pub(in crate::cli) fn test_view(&self, n: usize, lens: Lens) -> Result<(Camera, f64), CliError> {
        let path = SplitName::Test.json_path(&self.record.dataset);
        let json = Transforms::read(&path)?;
        let Some(frame) = json.frames.get(n) else {
            let last = json.frames.len().saturating_sub(1);
            return Err(CliError::input(format!("--view {n}: {} has views 0 to {last}", path.display())));
        };
        Ok((json.intrinsics.camera(lens.width, lens.height, frame.camera_to_world), frame.time))
    }

    /// Checks the distance of cameras on a path (the value of `--radius`).
    ///
    /// # Errors
    /// As [`RunFolder::camera_at`].
    pub(in crate::cli) fn check_radius(&self, radius: f64) -> Result<(), CliError> {
        check_distance(&format!("--radius {radius}"), radius, self.half_size())
    }

    /// Half the longest side of the scene's box.
    fn half_size(&self) -> f64 {
        self.scene.spec.half_size.into_iter().fold(f32::MIN_POSITIVE, f32::max).into()
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
            assert_eq!(error.code(), 2);
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
        assert!(error.code() == 2 && error.to_string().starts_with("--size 4294967295: needs about"), "{error}");
    }
}
