//! Normalisation of a dataset's coordinates. The program calculates in single precision, with a near plane and a few
//! other lengths that suit the published data. Datasets of any size and place are therefore moved and scaled as they are
//! read, in double precision; those of usual size and place are read as they are:
//!
//! ```text
//! dataset position = centre + scale * scene position
//! ```
//!
//! * The *distance* of the cameras is the mean distance from the point that they look at, but at most [`NARROW`] times
//!   their mean distance from each other's centre: cameras that are close together do not tell how far away the data
//!   are. It is usual within [`USUAL`]; otherwise `scale` is the power of two that brings it nearest to that of the
//!   published data.
//! * `centre` is the origin if the point lies within [`OFFSET`] distances of it, and otherwise that point.

use glam::{DMat4, DVec3};
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;
use std::path::Path;

use super::calibration::{Calibration, PhysicalSpace};
use super::camera::{Camera, look_at_point};
use super::dataset::SplitName;
use super::error::DataError;
use super::paths::RADIUS;

/// Usual distances of cameras from the data. At the lower end, the near plane (0.2) is at a quarter of the distance.
pub const USUAL: RangeInclusive<f64> = 0.8..=100.0;
/// Largest usual offset of the data from the origin, in camera distances: there, single precision still resolves the
/// last steps of training, which are about a millionth of the distance.
pub const OFFSET: f64 = 10.0;
/// Largest distance of the data, in mean distances of the cameras from their centre.
pub const NARROW: f64 = 10.0;

/// Share of their distance from the origin down to which positions differ; below, they are one position with the errors
/// of rounding.
const SAME: f64 = 1e-9;

/// How scene coordinates follow from those of a dataset, see the module.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Normalisation {
    /// The scene's origin, in the dataset's coordinates.
    pub centre: DVec3,
    /// Length of one scene unit in the dataset's units; finite and positive.
    pub scale: f64,
}

impl Default for Normalisation {
    fn default() -> Self {
        Self::NONE
    }
}

impl Normalisation {
    /// Of datasets of usual size and place: scene coordinates are those of the dataset.
    pub const NONE: Self = Self { centre: DVec3::ZERO, scale: 1.0 };

    /// Whether scene coordinates are those of the dataset.
    pub fn is_none(&self) -> bool {
        *self == Self::NONE
    }

    /// The normalisation of a dataset with these camera-to-world poses, see the module.
    pub fn from_poses(poses: impl ExactSizeIterator<Item = DMat4> + Clone) -> Self {
        let n = poses.len().max(1) as f64;
        let positions = poses.clone().map(|pose| pose.w_axis.truncate());
        let mean = positions.clone().sum::<DVec3>() / n;
        let from = |point: DVec3| positions.clone().map(|p| p.distance(point)).sum::<f64>() / n;
        let spread = from(mean);
        let (centre, distance) = if spread <= SAME * mean.length() {
            // one position, whose distance from the data is at least not known to differ from that from the origin
            (DVec3::ZERO, mean.length())
        } else {
            // relative to the mean, so that no digits are lost far from the origin
            let moved = |pose: DMat4| Camera::from_fov_x(1.0, 1, 1, DMat4::from_translation(-mean) * pose);
            let cameras: Vec<Camera> = poses.map(moved).collect();
            let seen = look_at_point(cameras.iter()).map(|(point, _)| point + mean);
            let seen = seen.map(|point| (point, from(point))).filter(|(_, distance)| *distance <= NARROW * spread);
            seen.unwrap_or((mean, NARROW * spread))
        };
        if !(distance.is_finite() && distance > 0.0) {
            return Self::NONE;
        }
        let scale = if USUAL.contains(&distance) { 1.0 } else { (distance / RADIUS).log2().round().exp2() };
        let near = centre.length() <= OFFSET * distance;
        // whole scene units, so that it can be read and written without rounding
        let centre = if near { DVec3::ZERO } else { (centre / scale).round() * scale };
        Self { centre, scale }
    }

    /// The normalisation of the dataset in the folder `root`, by its training views; none if it has no such views.
    ///
    /// # Errors
    /// Training views that cannot be read.
    pub fn of_dataset(root: &Path) -> Result<Self, DataError> {
        if !SplitName::Train.json_path(root).exists() {
            return Ok(Self::NONE);
        }
        Ok(SplitName::Train.views(root)?.normalisation())
    }

    /// The point of the scene at a position of the dataset.
    pub fn to_scene(&self, position: DVec3) -> DVec3 {
        (position - self.centre) / self.scale
    }

    /// The position in the dataset of a point of the scene.
    pub fn to_dataset(&self, scene: DVec3) -> DVec3 {
        self.centre + self.scale * scene
    }

    /// The camera-to-world pose in the scene.
    pub fn pose(&self, camera_to_world: DMat4) -> DMat4 {
        let DMat4 { x_axis, y_axis, z_axis, w_axis } = camera_to_world;
        DMat4 { x_axis, y_axis, z_axis, w_axis: self.to_scene(w_axis.truncate()).extend(w_axis.w) }
    }

    /// Physical space and time of the scene, from those of the dataset's coordinates.
    pub fn calibration(&self, dataset: Calibration) -> Calibration {
        if self.is_none() {
            return dataset;
        }
        let space = match dataset.space {
            Some(space) => PhysicalSpace {
                centre: space.position(self.centre.to_array()),
                scale: space.scale * self.scale,
                ..space
            },
            None => PhysicalSpace { centre: self.centre.to_array(), scale: self.scale, unit: None, axes: None },
        };
        Calibration { space: Some(space), time: dataset.time }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::paths::{Lens, training_cameras};

    fn sphere(radius: f64, centre: DVec3) -> Vec<DMat4> {
        let cameras = training_cameras(40, radius, Lens { fov_x: 0.5, width: 8, height: 8 });
        cameras.iter().map(|c| DMat4::from_translation(centre) * c.camera_to_world).collect()
    }

    fn of(poses: &[DMat4]) -> Normalisation {
        Normalisation::from_poses(poses.iter().copied())
    }

    fn distance_after(poses: &[DMat4]) -> f64 {
        let n = of(poses);
        let seen = poses.iter().map(|p| Camera::from_fov_x(1.0, 1, 1, n.pose(*p))).collect::<Vec<_>>();
        let (point, _) = look_at_point(seen.iter()).unwrap();
        seen[0].position().distance(point)
    }

    #[test]
    fn usual_datasets_are_read_as_they_are() {
        for (radius, centre) in [(RADIUS, DVec3::ZERO), (1.0, DVec3::X), (90.0, DVec3::splat(400.0)), (2.0, DVec3::Y)] {
            let poses = sphere(radius, centre);
            let n = of(&poses);
            assert!(n.is_none(), "{radius} {centre}: {n:?}");
            assert_eq!(n.pose(poses[3]), poses[3]);
            assert_eq!(n.calibration(Calibration::default()), Calibration::default());
        }
    }

    #[test]
    fn any_size_and_place_becomes_usual() {
        for radius in [1e-12, 1e-4, 0.01, 0.15, 1e3, 4e4, 1e9] {
            for centre in [DVec3::ZERO, DVec3::new(4.5e5, 5.4e6, 300.0)] {
                let poses = sphere(radius, centre);
                // where the cameras are told apart
                if radius <= SAME * centre.length() {
                    continue;
                }
                let n = of(&poses);
                assert_eq!(n.scale.log2().fract(), 0.0);
                let after = distance_after(&poses);
                assert!((2.8..5.8).contains(&after), "{radius} {centre}: {n:?} {after}");
                let point = n.to_scene(centre);
                assert!(point.length() <= OFFSET * after, "{n:?} {point}");
            }
        }
        let shifted = of(&sphere(2.0, DVec3::new(5000.0, -3000.25, 800.0)));
        assert_eq!((shifted.centre, shifted.scale), (DVec3::new(5000.0, -3000.0, 800.0), 1.0));
    }

    #[test]
    fn cameras_that_do_not_tell_the_distance_never_bring_the_data_too_near() {
        let at = |x: f64, turn: f64| DMat4::from_translation(DVec3::new(x, 0.0, 4.0)) * DMat4::from_rotation_y(turn);
        // axes that meet a thousand baselines away, or never
        for turn in [1e-3, 0.0] {
            let n = of(&[at(-1.0, -turn), at(1.0, turn), at(0.0, 0.0)]);
            assert!(n.is_none(), "{n:?}");
        }
        let one = of(&[at(0.0, 0.0); 5]);
        assert!(one.is_none(), "as far away as the origin: {one:?}");
        assert!(of(&[]).is_none() && of(&[DMat4::IDENTITY]).is_none());
        let outward: Vec<DMat4> = (0..8).map(|k| DMat4::from_rotation_y(f64::from(k))).collect();
        assert!(of(&outward).is_none(), "all at the origin");
    }

    #[test]
    fn the_physical_space_of_the_data_is_kept() {
        let n = Normalisation { centre: DVec3::new(100.0, 0.0, 0.0), scale: 0.5 };
        let alone = n.calibration(Calibration::default());
        assert_eq!((alone.position([2.0, 0.0, 1.0]), alone.length_unit()), ([101.0, 0.0, 0.5], "data units"));
        let space = PhysicalSpace { centre: [1.0, 2.0, 3.0], scale: 10.0, unit: Some("mm".into()), axes: None };
        let both = n.calibration(Calibration { space: Some(space), time: None });
        assert_eq!((both.position([0.0, 0.0, 2.0]), both.length_unit()), ([1001.0, 2.0, 13.0], "mm"));
        assert_eq!(n.to_scene(DVec3::new(101.0, 0.0, 0.5)), DVec3::new(2.0, 0.0, 1.0));
        assert_eq!(n.to_dataset(DVec3::new(2.0, 0.0, 1.0)), DVec3::new(101.0, 0.0, 0.5));
    }
}
