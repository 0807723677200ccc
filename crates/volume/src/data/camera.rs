//! The pinhole camera and its conventions. Nothing here reads files.

use glam::{DMat3, DMat4, DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// A pinhole camera without distortion.
///
/// Poses are kept in the NeRF/OpenGL convention (+x right, +y up, looking along -z); images and `project` use the
/// OpenCV one (x right, y down, z forward). Pixel coordinates are continuous: the centre of pixel `(i, j)` is
/// `(i + 0.5, j + 0.5)`, and the image covers `[0, width] x [0, height]`.
///
/// ```
/// use glam::{DVec2, DVec3};
/// use volseggs_volume::data::Camera;
/// let camera = Camera::look_at(DVec3::new(4.0, 0.0, 0.0), DVec3::ZERO, DVec3::Z, 0.5, 64, 48);
/// let (pixel, depth) = camera.project(DVec3::ZERO).ok_or("behind the camera")?;
/// assert!(pixel.abs_diff_eq(DVec2::new(32.0, 24.0), 1e-9) && (depth - 4.0).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Focal length in x, pixels.
    pub fx: f64,
    /// Focal length in y, pixels.
    pub fy: f64,
    /// Principal point x, pixels.
    pub cx: f64,
    /// Principal point y, pixels.
    pub cy: f64,
    /// Camera-to-world `[4, 4]`, rigid, NeRF/OpenGL axes.
    pub camera_to_world: DMat4,
}

impl Camera {
    /// A camera with square pixels and the principal point at the centre; `camera_angle_x` is the whole
    /// horizontal field of view in radians.
    pub fn from_fov_x(camera_angle_x: f64, width: u32, height: u32, camera_to_world: DMat4) -> Self {
        let (w, h) = (f64::from(width), f64::from(height));
        let focal = 0.5 * w / (0.5 * camera_angle_x).tan();
        Self { width, height, fx: focal, fy: focal, cx: 0.5 * w, cy: 0.5 * h, camera_to_world }
    }

    /// A camera at `eye` looking at `target` without roll about `up`; `fov_x` in radians.
    ///
    /// If `up` is parallel to the view, whichever of the world's x and y axes is less aligned with the view replaces
    /// it; `eye == target` looks along -z.
    pub fn look_at(eye: DVec3, target: DVec3, up: DVec3, fov_x: f64, width: u32, height: u32) -> Self {
        let back = (eye - target).try_normalize().unwrap_or(DVec3::Z);
        let right = up.cross(back).try_normalize().unwrap_or_else(|| {
            let axis = if back.x.abs() <= back.y.abs() { DVec3::X } else { DVec3::Y };
            axis.cross(back).normalize()
        });
        let camera_to_world =
            DMat4::from_cols(right.extend(0.0), back.cross(right).extend(0.0), back.extend(0.0), eye.extend(1.0));
        Self::from_fov_x(fov_x, width, height, camera_to_world)
    }

    /// The camera centre in world coordinates.
    pub fn position(&self) -> DVec3 {
        self.camera_to_world.w_axis.truncate()
    }

    /// The unit viewing direction in world coordinates.
    pub fn forward(&self) -> DVec3 {
        -self.camera_to_world.z_axis.truncate().normalize_or(DVec3::Z)
    }

    /// The whole horizontal field of view in radians.
    pub fn fov_x(&self) -> f64 {
        2.0 * (0.5 * f64::from(self.width) / self.fx).atan()
    }

    /// The whole vertical field of view in radians.
    pub fn fov_y(&self) -> f64 {
        2.0 * (0.5 * f64::from(self.height) / self.fy).atan()
    }

    /// The largest `|x/z|` or `|y/z|` in the picture: the tangent of half the larger field of view, or more if the principal
    /// point is off centre.
    pub fn widest_slope(&self) -> f64 {
        let along = |size: u32, focal: f64, principal: f64| principal.max(f64::from(size) - principal) / focal;
        along(self.width, self.fx, self.cx).max(along(self.height, self.fy, self.cy))
    }

    /// `(R [3, 3], t [3])` with `x_camera = R * x_world + t` in OpenCV axes (x right, y down, z forward).
    pub fn world_to_camera_opencv(&self) -> (DMat3, DVec3) {
        let m = DMat3::from_mat4(self.camera_to_world);
        let rotation = DMat3::from_cols(m.x_axis, -m.y_axis, -m.z_axis).transpose();
        (rotation, -(rotation * self.position()))
    }

    /// The continuous pixel of a world point and its depth along the optical axis (scene units); none for a
    /// point at or behind the camera plane. The pixel may lie outside the image.
    pub fn project(&self, point: DVec3) -> Option<(DVec2, f64)> {
        let (rotation, translation) = self.world_to_camera_opencv();
        let p = rotation * point + translation;
        (p.z > 1e-9).then(|| (DVec2::new(self.fx * p.x / p.z + self.cx, self.fy * p.y / p.z + self.cy), p.z))
    }

    /// The world point that [`Camera::project`] maps to this continuous pixel and depth.
    pub fn unproject(&self, pixel: DVec2, depth: f64) -> DVec3 {
        let (rotation, translation) = self.world_to_camera_opencv();
        let p = DVec3::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy, 1.0) * depth;
        rotation.transpose() * (p - translation)
    }

    /// The same camera for an image reduced by the integer `factor` (0 counts as 1) in both axes.
    ///
    /// Exact where `factor` divides the size, which image loading requires; otherwise the surplus pixels at the right
    /// and bottom are cut off.
    pub fn downscaled(&self, factor: u32) -> Self {
        let factor = factor.max(1);
        let k = f64::from(factor);
        Self {
            width: self.width / factor,
            height: self.height / factor,
            fx: self.fx / k,
            fy: self.fy / k,
            cx: self.cx / k,
            cy: self.cy / k,
            camera_to_world: self.camera_to_world,
        }
    }
}

/// The point nearest to all optical axes in the least-squares sense, and the root-mean-square distance to them;
/// none where the axes are (nearly) parallel or there are fewer than two.
pub fn look_at_point<'a>(cameras: impl Iterator<Item = &'a Camera> + Clone) -> Option<(DVec3, f64)> {
    let (mut a, mut b, mut n) = (DMat3::ZERO, DVec3::ZERO, 0.0);
    for camera in cameras.clone() {
        let off_axis = off_axis(camera.forward());
        a += off_axis;
        b += off_axis * camera.position();
        n += 1.0;
    }
    if n < 2.0 || a.determinant().is_nan() || a.determinant() <= 1e-6 * n * n * n {
        return None;
    }
    let point = a.inverse() * b;
    let square: f64 = cameras.map(|c| (off_axis(c.forward()) * (point - c.position())).length_squared()).sum();
    point.is_finite().then(|| (point, (square / n).sqrt()))
}

/// `I - d d^T`, the projection onto the plane perpendicular to the unit vector `d`.
fn off_axis(d: DVec3) -> DMat3 {
    DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn camera(eye: DVec3) -> Camera {
        Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 30f64.to_radians(), 400, 300)
    }

    #[test]
    fn focal_length_of_thirty_degrees() {
        let c = Camera::from_fov_x(std::f64::consts::FRAC_PI_6, 800, 800, DMat4::IDENTITY);
        assert!((c.fx - 1_492.820_323).abs() < 1e-5 && c.fx == c.fy && c.cx == 400.0);
        assert!((c.fov_x() - std::f64::consts::FRAC_PI_6).abs() < 1e-12);
    }

    #[test]
    fn axes_follow_the_conventions() {
        // At +x looking at the origin: world +y is to the right, world +z is up (smaller pixel y).
        let c = camera(DVec3::new(4.0, 0.0, 0.0));
        let (centre, depth) = c.project(DVec3::ZERO).unwrap();
        assert!((centre - DVec2::new(200.0, 150.0)).length() < 1e-9 && (depth - 4.0).abs() < 1e-12);
        assert!(c.project(DVec3::Y * 0.1).unwrap().0.x > 200.0);
        assert!(c.project(DVec3::Z * 0.1).unwrap().0.y < 150.0);
        assert!(c.project(DVec3::X * 5.0).is_none() && c.project(c.position()).is_none());
        assert!((c.forward() + DVec3::X).length() < 1e-12);
    }

    #[test]
    fn degenerate_up_still_gives_a_rigid_pose() {
        for eye in [DVec3::Z, -DVec3::Z, DVec3::ZERO] {
            let m = DMat3::from_mat4(camera(eye).camera_to_world);
            assert!((m.determinant() - 1.0).abs() < 1e-12, "{eye}");
        }
    }

    #[test]
    fn look_at_point_is_found_or_refused() {
        let cameras = [DVec3::X * 3.0, DVec3::Y * 2.0, DVec3::ONE].map(camera);
        let (point, error) = look_at_point(cameras.iter()).unwrap();
        assert!(point.length() < 1e-9 && error < 1e-9);
        assert!(look_at_point(cameras[..1].iter()).is_none());
        let same = [camera(DVec3::X), camera(DVec3::X)];
        assert!(look_at_point(same.iter()).is_none());
    }

    proptest! {
        #[test]
        fn projection_agrees_with_the_matrices(
            e in prop::array::uniform3(-5.0..5.0f64), p in prop::array::uniform3(-1.0..1.0f64), factor in 1u32..8
        ) {
            let (eye, p) = (DVec3::from_array(e), DVec3::from_array(p));
            prop_assume!(eye.length() > 2.0);
            let c = camera(eye);
            let (rotation, translation) = c.world_to_camera_opencv();
            prop_assert!((rotation.determinant() - 1.0).abs() < 1e-9);
            prop_assert!((rotation * c.position() + translation).length() < 1e-9);
            if let Some((pixel, depth)) = c.project(p) {
                let ray = DVec3::new((pixel.x - c.cx) / c.fx, (pixel.y - c.cy) / c.fy, 1.0) * depth;
                prop_assert!((rotation.transpose() * (ray - translation) - p).length() < 1e-6);
                let small = c.downscaled(factor).project(p).unwrap();
                prop_assert!((small.0 * f64::from(factor) - pixel).length() < 1e-6);
            }
            let text = serde_json::to_string(&c).unwrap();
            prop_assert_eq!(serde_json::from_str::<Camera>(&text).unwrap(), c);
        }
    }
}
