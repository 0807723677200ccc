//! Rays through pixels.

use volseggs_kernels::PinholeCamera;
use volseggs_kernels::march::Ray;

/// A camera prepared for casting rays through its pixels.
#[derive(Clone, Copy, Debug)]
pub struct RayCamera {
    camera: PinholeCamera,
    origin: [f32; 3],
}

impl RayCamera {
    /// Prepares the camera.
    pub fn new(camera: PinholeCamera) -> Self {
        let across = |k: usize| -(0..3).map(|r| camera.rotation[r][k] * camera.translation[r]).sum::<f32>();
        Self { camera, origin: [across(0), across(1), across(2)] }
    }

    /// The ray through the centre of pixel `at` (row-major), with a direction of unit length.
    pub fn ray(&self, at: usize, jitter: f32) -> Ray {
        let c = &self.camera;
        let seen = [((at % c.width) as f32 + 0.5 - c.cx) / c.fx, ((at / c.width) as f32 + 0.5 - c.cy) / c.fy, 1.0];
        let norm = seen.iter().map(|v| v * v).sum::<f32>().sqrt();
        let along = |k: usize| (0..3).map(|r| c.rotation[r][k] * seen[r]).sum::<f32>() / norm;
        Ray { origin: self.origin, direction: [along(0), along(1), along(2)], jitter }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DVec2, DVec3};
    use volseggs_core::model::ToKernel;
    use volseggs_volume::data;

    #[test]
    fn a_ray_meets_what_its_pixel_shows() {
        let eye = DVec3::new(2.0, -1.0, 3.0);
        let camera = data::Camera::look_at(eye, DVec3::new(0.1, 0.2, 0.0), DVec3::Z, 0.7, 20, 10);
        let rays = RayCamera::new(camera.to_kernel());
        for (x, y) in [(0, 0), (19, 9), (7, 3)] {
            let ray = rays.ray(20 * y + x, 0.25);
            let shown = camera.unproject(DVec2::new(x as f64 + 0.5, y as f64 + 0.5), 2.0);
            let [origin, direction] = [ray.origin, ray.direction].map(|v| DVec3::from_array(v.map(f64::from)));
            assert!(origin.distance(eye) < 1e-5 && (direction.length() - 1.0).abs() < 1e-6);
            let met = origin + direction * shown.distance(eye);
            assert!(met.distance(shown) < 1e-5, "{met} for {shown}");
        }
    }
}
