//! Camera paths: spherical Fibonacci training cameras, the spiral of test views, orbits; and the time that each view
//! shows. All cameras look at the centre of their sphere, with z up.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::camera::Camera;
use crate::rng::{Purpose, Rng};

/// Distance of the cameras from the origin in the published datasets.
pub const RADIUS: f64 = 4.0311;
/// Horizontal field of view of the published datasets: 30 degrees, in radians.
pub const FOV_X: f64 = PI / 6.0;
/// Minimum distance of the spiral from a pole, in radians, so that "up" stays defined.
pub const POLE_GAP: f64 = 1.75e-4;

/// The sphere on which the cameras of a path lie, looking at its centre.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Sphere {
    /// The centre, scene units.
    pub centre: DVec3,
    /// Distance of the cameras from the centre, scene units.
    pub radius: f64,
}

impl Sphere {
    /// The sphere around `centre` on which `camera` lies.
    pub fn through(camera: &Camera, centre: DVec3) -> Self {
        Self { centre, radius: camera.position().distance(centre) }
    }
}

/// Around the origin, as in the published datasets.
impl From<f64> for Sphere {
    fn from(radius: f64) -> Self {
        Self { centre: DVec3::ZERO, radius }
    }
}

/// The properties shared by all cameras of a path.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Lens {
    /// Whole horizontal field of view in radians.
    pub fov_x: f64,
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
}

impl Lens {
    /// The camera at `offset` from the centre of `sphere`.
    fn at(&self, sphere: Sphere, offset: DVec3) -> Camera {
        let eye = sphere.centre + offset;
        Camera::look_at(eye, sphere.centre, DVec3::Z, self.fov_x, self.width, self.height)
    }
}

/// `n` points spread evenly over the sphere of `radius`, from the bottom (-z) up.
///
/// With `g = (3 - sqrt 5) pi` and `h_i` evenly spaced from `1/n - 1` to `1 - 1/n`, point i is
/// `radius * (-s cos(g i), h_i, s sin(g i))`, `s = sqrt(1 - h_i^2)`; then sorted by z.
pub fn fibonacci(n: usize, radius: f64) -> Vec<DVec3> {
    let golden = (3.0 - 5f64.sqrt()) * PI;
    let mut points: Vec<DVec3> = (0..n)
        .map(|i| {
            let h = (2.0 * i as f64 + 1.0) / n as f64 - 1.0;
            let (sin, cos) = (golden * i as f64).sin_cos();
            let s = (1.0 - h * h).sqrt();
            radius * DVec3::new(-s * cos, h, s * sin)
        })
        .collect();
    points.sort_by(|a, b| a.z.total_cmp(&b.z));
    points
}

/// The `n` training cameras of a Fibonacci sphere.
pub fn training_cameras(n: usize, sphere: impl Into<Sphere>, lens: Lens) -> Vec<Camera> {
    let sphere = sphere.into();
    fibonacci(n, sphere.radius).into_iter().map(|offset| lens.at(sphere, offset)).collect()
}

/// A world axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// x.
    X,
    /// y.
    Y,
    /// z.
    Z,
}

impl Axis {
    /// Returns its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
        }
    }
}

impl std::str::FromStr for Axis {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "x" => Ok(Self::X),
            "y" => Ok(Self::Y),
            "z" => Ok(Self::Z),
            _ => Err(format!("`{text}` is not an axis; use x, y or z")),
        }
    }
}

/// `n` cameras that look along `axis` or against it, within `angle` (radians) of it: on two caps of the sphere, each
/// covered evenly. These are the view sets biased along one axis of the paper's last table, which gives no angle.
pub fn biased(n: usize, sphere: impl Into<Sphere>, axis: Axis, angle: f64, lens: Lens) -> Vec<Camera> {
    let sphere = sphere.into();
    let golden = (3.0 - 5f64.sqrt()) * PI;
    let cap = 1.0 - angle.clamp(0.0, FRAC_PI_2).cos();
    (0..n)
        .map(|i| {
            let side = if i % 2 == 0 { 1.0 } else { -1.0 };
            let along = 1.0 - cap * ((i / 2) as f64 + 0.5) / n.div_ceil(2) as f64;
            let (sin, cos) = (golden * i as f64).sin_cos();
            let across = (1.0 - along * along).sqrt();
            let (a, b, c) = (across * cos, across * sin, side * along);
            let point = match axis {
                Axis::X => DVec3::new(c, a, b),
                Axis::Y => DVec3::new(b, c, a),
                Axis::Z => DVec3::new(a, b, c),
            };
            lens.at(sphere, sphere.radius * point)
        })
        .collect()
}

/// `count` time indices evenly spread over `0..total`, rounded down: 30 of 100 give 0, 3, 6, 10, 13, ... 99.
pub fn time_indices(count: usize, total: usize) -> Vec<usize> {
    let last = total.saturating_sub(1);
    (0..count).map(|i| if count < 2 { 0 } else { i * last / (count - 1) }).collect()
}

/// Assigns `views_per_time` views to each of `times` at random: entry i is the index in the list of times that view i
/// shows, `[times * views_per_time]`.
pub fn deal_times(times: usize, views_per_time: usize, seed: u64) -> Vec<usize> {
    let mut deal: Vec<usize> = (0..times * views_per_time).map(|i| i % times).collect();
    Rng::new(seed, 0, Purpose::ViewTimes).shuffle(&mut deal);
    deal
}

/// The test path, `views` cameras each with its time in [0, 1]: elevation rises from -90 to 90 degrees while the
/// azimuth turns once from -90 degrees, and the time steps through `timesteps` (181 and 100 as published).
pub fn test_spiral(views: usize, timesteps: usize, sphere: impl Into<Sphere>, lens: Lens) -> Vec<(Camera, f64)> {
    let sphere = sphere.into();
    let (last, last_time) = (views.saturating_sub(1).max(1), timesteps.saturating_sub(1));
    (0..views)
        .map(|i| {
            let along = i as f64 / last as f64;
            let elevation = (PI * along - FRAC_PI_2).clamp(POLE_GAP - FRAC_PI_2, FRAC_PI_2 - POLE_GAP);
            let offset = on_sphere(sphere.radius, elevation, 2.0 * PI * along - FRAC_PI_2);
            let time = (i * last_time / last) as f64 / last_time.max(1) as f64;
            (lens.at(sphere, offset), time)
        })
        .collect()
}

/// `n` cameras on a level circle at `elevation` (radians above the xy plane), starting at azimuth -90 degrees;
/// the circle closes, so the last camera stands one step before the first.
pub fn orbit(n: usize, sphere: impl Into<Sphere>, elevation: f64, lens: Lens) -> Vec<Camera> {
    let sphere = sphere.into();
    let elevation = elevation.clamp(POLE_GAP - FRAC_PI_2, FRAC_PI_2 - POLE_GAP);
    let azimuth = |i: usize| 2.0 * PI * i as f64 / n as f64 - FRAC_PI_2;
    (0..n).map(|i| lens.at(sphere, on_sphere(sphere.radius, elevation, azimuth(i)))).collect()
}

fn on_sphere(radius: f64, elevation: f64, azimuth: f64) -> DVec3 {
    let (sin_e, cos_e) = elevation.sin_cos();
    let (sin_a, cos_a) = azimuth.sin_cos();
    radius * DVec3::new(cos_e * cos_a, cos_e * sin_a, sin_e)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::transforms::Transforms;

    const LENS: Lens = Lens { fov_x: FOV_X, width: 400, height: 400 };

    #[test]
    fn fibonacci_known_positions() {
        let points = fibonacci(600, RADIUS);
        for (i, p) in [
            (0, [0.361_645_238, 0.047_029_5, -4.014_569_486]),
            (1, [-0.176_336_265, 0.329_206_5, -4.013_763_298]),
            (299, [-0.232_638_674, -4.024_381_5, 0.0]),
            (450, [3.002_941_686, -1.793_839_5, 2.003_558_906]),
            (599, [-0.195_278_412, -0.181_399_5, 4.022_278_928]),
        ] {
            assert!((points[i] - DVec3::from_array(p)).length() < 1e-6, "{i}: {}", points[i]);
        }
        assert!(fibonacci(0, 1.0).is_empty() && fibonacci(1, 1.0)[0].is_finite());
    }

    #[test]
    fn spiral_known_positions() {
        let path = test_spiral(181, 100, RADIUS, LENS);
        for (i, p, time) in [
            (0, [0.0, -0.000_705_442, -4.031_099_938], 0),
            (1, [0.002_455_263, -0.070_309_539, -4.030_486_044], 0),
            (45, [2.850_418_146, 0.0, -2.850_418_146], 24),
            (90, [0.0, 4.0311, 0.0], 49),
            (133, [-2.940_978_337, 0.205_653_239, 2.749_203_588], 73),
        ] {
            assert!((path[i].0.position() - DVec3::from_array(p)).length() < 1e-6, "{i}");
            assert!((path[i].1 - f64::from(time) / 99.0).abs() < 1e-12, "{i}");
        }
        assert_eq!(path[180].1, 1.0);
        assert!(test_spiral(1, 1, 1.0, LENS)[0].0.position().is_finite());
    }

    #[test]
    fn times_are_spread_and_dealt_evenly() {
        let known = [
            0, 3, 6, 10, 13, 17, 20, 23, 27, 30, 34, 37, 40, 44, 47, 51, 54, 58, 61, 64, 68, 71, 75, 78, 81, 85, 88,
            92, 95, 99,
        ];
        assert_eq!(time_indices(30, 100), known);
        assert_eq!((time_indices(1, 100), time_indices(0, 5)), (vec![0], vec![]));
        let deal = deal_times(30, 20, 1);
        assert!((0..30).all(|t| deal.iter().filter(|x| **x == t).count() == 20));
        assert_ne!(deal, deal_times(30, 20, 2));
        assert!(deal_times(0, 20, 1).is_empty());
    }

    #[test]
    fn orbit_keeps_its_height_and_distance() {
        let path = orbit(8, 3.0, 0.5, LENS);
        assert_eq!(path.len(), 8);
        for c in &path {
            assert!((c.position().length() - 3.0).abs() < 1e-12);
            assert!((c.position().z - 3.0 * 0.5f64.sin()).abs() < 1e-12);
            assert!((c.project(DVec3::ZERO).unwrap().0.x - 200.0).abs() < 1e-9);
        }
    }

    #[test]
    fn every_path_looks_at_the_centre_of_its_sphere() {
        let sphere = Sphere { centre: DVec3::new(5.0, -2.0, 7.0), radius: 3.0 };
        let spiral = test_spiral(9, 5, sphere, LENS).into_iter().map(|(camera, _)| camera);
        let paths =
            [training_cameras(9, sphere, LENS), biased(9, sphere, Axis::Y, 0.3, LENS), orbit(9, sphere, 0.4, LENS)];
        for c in paths.into_iter().flatten().chain(spiral) {
            assert!((c.position().distance(sphere.centre) - 3.0).abs() < 1e-9);
            let pixel = c.project(sphere.centre).unwrap().0;
            assert!((pixel.x - 200.0).abs() < 1e-6 && (pixel.y - 200.0).abs() < 1e-6, "{pixel}");
        }
    }

    /// The published poses are single precision with 1e-8 added, good to 1e-6 of the radius.
    #[test]
    fn reproduces_the_published_poses() {
        let Some(root) = crate::data::dataset::test_data() else {
            return;
        };
        let check = |file: &str, cameras: &[Camera], times: Option<&[f64]>| {
            let json = Transforms::read(&root.join(file)).unwrap();
            assert_eq!(json.frames.len(), cameras.len());
            for (i, (frame, camera)) in json.frames.iter().zip(cameras).enumerate() {
                let off = (frame.camera_to_world.w_axis - camera.camera_to_world.w_axis).length();
                assert!(off < 1e-6 * RADIUS, "{file} frame {i}: {off}");
                // Next to a pole "right" turns with the rounding of x, by 1.4e-5.
                let off = (frame.camera_to_world - camera.camera_to_world).abs_diff_eq(glam::DMat4::ZERO, 2e-5);
                assert!(off, "{file} frame {i}");
                if let Some(times) = times {
                    assert!((frame.time - times[i]).abs() < 1e-12);
                }
            }
        };
        check("transforms_train.json", &training_cameras(600, RADIUS, LENS), None);
        let (cameras, times): (Vec<_>, Vec<_>) = test_spiral(181, 100, RADIUS, LENS).into_iter().unzip();
        check("transforms_test.json", &cameras, Some(&times));
    }
}
