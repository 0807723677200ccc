//! Fixtures for the tests of this crate and of those above it: two balls of Gaussians on the x axis, and cameras around
//! them.

#![allow(clippy::unwrap_used, clippy::missing_panics_doc, clippy::must_use_candidate)] // called by tests alone

use crate::data::Camera;
use crate::device::DeviceName;
use crate::model::{HostGaussians, Rendering, ToKernel};
use crate::rng::{Purpose, Rng};
use crate::segment::colour::fibonacci_sphere;
use crate::segment::fine::network::PositionBox;
use crate::segment::fine::views::{FineView, MaskedView, rank_scales};
use crate::segment::masks::Mask;
use glam::DVec3;

/// Gaussians in a ball.
pub const COUNT: usize = 60;
const RADIUS: f64 = 0.35;
const SIZE: u32 = 40;

/// Positions of the balls and their numbers of Gaussians.
#[derive(Clone, Copy)]
pub struct Balls {
    /// Distance of each centre from the origin.
    pub apart: f64,
    /// Gaussians in each ball.
    pub count: usize,
}

/// Balls with a gap between them.
pub const APART: Balls = Balls { apart: 0.5, count: COUNT };
/// Balls that touch in one point.
pub const TOUCHING: Balls = Balls { apart: RADIUS, count: COUNT };

impl Balls {
    fn centres(self) -> [DVec3; 2] {
        [DVec3::new(-self.apart, 0.0, 0.0), DVec3::new(self.apart, 0.0, 0.0)]
    }

    /// The first ball's Gaussians, then the second's.
    pub fn gaussians(self) -> HostGaussians {
        let mut rng = Rng::new(5, 0, Purpose::Custom(0));
        let mut out = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
        for centre in self.centres() {
            for _ in 0..self.count {
                let direction = DVec3::from_array([0; 3].map(|_| f64::from(rng.normal()))).normalize();
                let place = centre + direction * 0.28 * f64::from(rng.uniform()).cbrt();
                add(&mut out, place.as_vec3().to_array(), [-2.7; 3]);
            }
        }
        out
    }

    /// Views from all around in which neither ball hides the other, each with the masks of the first ball, of the
    /// second, and of both.
    pub fn views(self) -> Vec<(volseggs_kernels::PinholeCamera, Vec<Mask>)> {
        let eyes =
            [[0.0, -4.0, 0.5], [1.0, -3.8, 1.5], [0.5, 3.9, -0.5], [-1.0, 3.5, 1.5], [0.3, 0.5, 4.0], [0.0, 0.8, -4.0]];
        eyes.into_iter().map(|eye| self.view(DVec3::from_array(eye))).collect()
    }

    fn view(self, eye: DVec3) -> (volseggs_kernels::PinholeCamera, Vec<Mask>) {
        let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.6, SIZE, SIZE);
        let (rotation, _) = camera.world_to_camera_opencv();
        let mut sets = vec![vec![false; (SIZE * SIZE) as usize]; 3];
        for at in 0..(SIZE * SIZE) as usize {
            let (x, y) = ((at as u32 % SIZE) as f64 + 0.5, (at as u32 / SIZE) as f64 + 0.5);
            let local = DVec3::new((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0);
            let ray = rotation.transpose() * local.normalize();
            for (ball, centre) in self.centres().into_iter().enumerate() {
                let to = centre - eye;
                if (to - ray * to.dot(ray)).length() < RADIUS {
                    (sets[ball][at], sets[2][at]) = (true, true);
                }
            }
        }
        let masks = sets.iter().map(|set| Mask::from_rows(SIZE, SIZE, set).unwrap()).collect();
        (camera.to_kernel(), masks)
    }

    /// The views prepared for training, each of all Gaussians `at`.
    pub fn prepared(self, at: &HostGaussians) -> Vec<FineView> {
        let device = DeviceName::all()[0].open().unwrap();
        let members: Vec<u32> = (0..at.len() as u32).collect();
        let frame = PositionBox::around(&at.means);
        let mut out: Vec<FineView> = (0..)
            .zip(self.views())
            .filter_map(|(number, (camera, masks))| {
                let settings = rendering().seen_by(camera);
                let view = MaskedView { members: members.clone(), settings, masks };
                FineView::new(at, &frame, &view, number, 0, &device).unwrap()
            })
            .collect();
        rank_scales(&mut out);
        out
    }
}

/// Rendering settings for the balls.
pub fn rendering() -> Rendering {
    Rendering::default()
}

/// Adds a Gaussian with the identity rotation.
pub fn add(to: &mut HostGaussians, mean: [f32; 3], log_scales: [f32; 3]) {
    to.means.extend(mean);
    to.rotations.extend([1.0, 0.0, 0.0, 0.0]);
    to.log_scales.extend(log_scales);
    to.opacity_logits.push(2.0);
    to.sh.extend([0.3; 3]);
}

/// Gaussians on the surfaces of `balls` along x, given as centre and radius, without those inside another ball; and the
/// ball of each Gaussian.
pub fn surfaces(balls: &[(f32, f32)]) -> (HostGaussians, Vec<usize>) {
    let (mut out, mut of) = (HostGaussians { sh_stride: 1, ..HostGaussians::default() }, Vec::new());
    for (ball, &(centre, radius)) in balls.iter().enumerate() {
        for [x, y, z] in fibonacci_sphere((1800.0 * radius * radius) as usize) {
            let place = [centre + radius * x, radius * y, radius * z];
            let buried = |&(c, r): &(f32, f32)| (place[0] - c).hypot(place[1].hypot(place[2])) < r - 1e-3;
            if !balls.iter().any(buried) {
                add(&mut out, place, [-3.0; 3]);
                of.push(ball);
            }
        }
    }
    (out, of)
}

/// Runs `work` on a pool of `threads` threads.
pub fn on_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}
