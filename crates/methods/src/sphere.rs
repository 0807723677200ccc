//! The position of a camera as two angles: the input of methods that render without a scene in space.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use volseggs_kernels::PinholeCamera;
use volseggs_volume::data::Split;
use volseggs_volume::data::hull::view_box;

/// The sphere of the training cameras.
///
/// The distance, roll and field of view of a camera are ignored: it is treated as one of the training cameras.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewSphere {
    /// The point that they look at, scene units.
    pub centre: DVec3,
    /// Half the side length of the cube around it that they show, scene units.
    pub half_size: f64,
    /// Their vertical axis: 0 x, 1 y, 2 z.
    pub up: usize,
    /// Whether this axis points downwards.
    pub flipped: bool,
}

/// The position of a camera on the sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Angles {
    /// Angle from the upward axis, radians, in [0, pi].
    pub polar: f64,
    /// Angle about that axis, counter-clockwise seen from its tip, radians, in [0, 2 pi).
    pub azimuth: f64,
}

impl ViewSphere {
    /// The sphere of a split's cameras: centred on the point nearest to what they look at, with the vertical axis most
    /// nearly perpendicular to the horizontal axes of all of them (the one that stays upright in their images).
    pub fn around(split: &Split) -> Self {
        let poses = || split.frames.iter().map(|f| DMat3::from_mat4(f.camera.camera_to_world));
        let sideways: DVec3 = poses().map(|pose| pose.x_axis * pose.x_axis).sum();
        let upwards: DVec3 = poses().map(|pose| pose.y_axis).sum();
        // ties go to the last, z
        let up = (0..3).rev().min_by(|a, b| sideways[*a].total_cmp(&sideways[*b])).unwrap_or(2);
        let shown = view_box(split);
        let half_size = (0.5 * shown.size().max_element()).max(1e-6);
        Self { centre: shown.centre(), half_size, up, flipped: upwards[up] < 0.0 }
    }

    /// Rejects what [`ViewSphere::around`] never returns, since a file may hold anything.
    ///
    /// # Errors
    /// A description of what is wrong.
    pub fn check(&self) -> Result<(), String> {
        if self.up > 2 || !self.centre.is_finite() || !(self.half_size > 0.0 && self.half_size.is_finite()) {
            return Err("sphere: its axis must be 0, 1 or 2, its centre finite, half_size above 0".into());
        }
        Ok(())
    }

    /// The position of the camera on the sphere.
    pub fn angles(&self, camera: &PinholeCamera) -> Angles {
        let row = |k: usize| DVec3::from_array(camera.rotation[k].map(f64::from));
        let t = camera.translation.map(f64::from);
        let eye = -(row(0) * t[0] + row(1) * t[1] + row(2) * t[2]);
        let out = (eye - self.centre).normalize_or(DVec3::Z);
        let sign = if self.flipped { -1.0 } else { 1.0 };
        let [a, b] = [(self.up + 1) % 3, (self.up + 2) % 3];
        Angles {
            polar: (sign * out[self.up]).clamp(-1.0, 1.0).acos(),
            azimuth: (sign * out[b]).atan2(out[a]).rem_euclid(TAU) % TAU,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use volseggs_core::model::ToKernel;
    use volseggs_volume::data::{self, Frame, ImageSet, SplitName};

    fn split(up: DVec3, centre: DVec3) -> Split {
        let eyes = [(1.0, 2.0, 3.0), (-2.0, 1.0, 0.5), (0.3, -2.0, -1.0), (2.0, 0.1, -2.0)];
        let frame = |(i, (x, y, z))| {
            let eye = centre + 4.0 * DVec3::new(x, y, z).normalize();
            let camera = data::Camera::look_at(eye, centre, up, 0.5, 8, 8);
            Frame { name: format!("{i}"), path: format!("{i}").into(), camera, time: 0.0 }
        };
        let frames = eyes.into_iter().enumerate().map(frame).collect();
        Split { name: SplitName::Train, frames, images: ImageSet { width: 8, height: 8, pixels: Vec::new() } }
    }

    #[test]
    fn the_axis_and_the_centre_are_found() {
        let centre = DVec3::new(0.2, -0.4, 1.0);
        for (up, axis, flipped) in
            [(DVec3::Z, 2, false), (-DVec3::Z, 2, true), (DVec3::X, 0, false), (-DVec3::Y, 1, true)]
        {
            let sphere = ViewSphere::around(&split(up, centre));
            assert_eq!((sphere.up, sphere.flipped), (axis, flipped), "{up}");
            assert!(sphere.centre.distance(centre) < 1e-6 && sphere.check().is_ok(), "{sphere:?}");
            assert!(ViewSphere { up: 3, ..sphere }.check().is_err());
        }
    }

    #[test]
    fn angles_are_those_of_spherical_coordinates() {
        for (up, x, y) in
            [(DVec3::Z, DVec3::X, DVec3::Y), (-DVec3::Z, DVec3::X, -DVec3::Y), (DVec3::X, DVec3::Y, DVec3::Z)]
        {
            let sphere = ViewSphere::around(&split(up, DVec3::ONE));
            for (polar, azimuth) in [(0.3f64, 0.1f64), (1.5, 3.0), (2.8, 4.0), (1.0, 6.25)] {
                let out = polar.sin() * (azimuth.cos() * x + azimuth.sin() * y) + polar.cos() * up;
                let camera = data::Camera::look_at(DVec3::ONE + 3.0 * out, DVec3::ONE, up, 0.5, 8, 8);
                let found = sphere.angles(&camera.to_kernel());
                let near = (found.polar - polar).abs() < 1e-5 && (found.azimuth - azimuth).abs() < 1e-5;
                assert!(near, "{up}: {found:?}, expected {polar} {azimuth}");
            }
        }
    }
}
