//! One Gaussian in the index space of a grid: which voxels it reaches and how much it adds along a row of x.

use super::LabelledCloud;
use crate::volume::grid::Grid;
use glam::{DMat3, DQuat, DVec3};

/// Standard deviations at which a Gaussian ends. The density there is 1/90 of its maximum.
const CUT: f64 = 3.0;

/// Opacity below which drawing skips a Gaussian.
const INVISIBLE: f32 = 1.0 / 255.0;

/// A Gaussian that votes.
#[derive(Clone, Debug)]
pub struct Splat {
    /// Its label.
    pub label: u16,
    /// First and last voxel of its box along x, y, z.
    pub reach: [[u32; 2]; 3],
    opacity: f32,
    centre: DVec3,
    /// Maps voxels to standard deviations along the axes of the Gaussian.
    whiten: DMat3,
}

impl Splat {
    /// The Gaussian `i`, or `None` if it is invisible, degenerate or reaches no voxel centre.
    pub fn new(cloud: &LabelledCloud<'_>, i: usize, grid: &Grid, smallest: f64) -> Option<Self> {
        let opacity = cloud.opacity[i];
        if !(opacity >= INVISIBLE && opacity.is_finite()) {
            return None;
        }
        let q: &[f32] = &cloud.rotations[4 * i..4 * i + 4];
        let q = DQuat::from_xyzw(q[1].into(), q[2].into(), q[3].into(), q[0].into());
        let length = q.length();
        if !(length > 0.0 && length.is_finite()) {
            return None;
        }
        let mut sigma = [0.0; 3];
        for (s, log) in sigma.iter_mut().zip(&cloud.log_scales[3 * i..3 * i + 3]) {
            let scale = log.exp();
            if !scale.is_normal() {
                return None;
            }
            *s = f64::from(scale).max(smallest);
        }
        let at = |k: usize| (f64::from(cloud.means[3 * i + k]) - grid.origin[k]) / grid.spacing[k];
        let centre = DVec3::new(at(0), at(1), at(2));
        if !centre.is_finite() {
            return None;
        }
        let axes = DMat3::from_quat(q / length);
        let sigma = DVec3::from(sigma);
        let mut reach = [[0; 2]; 3];
        for k in 0..3 {
            let half = CUT * (axes.row(k) * sigma).length() / grid.spacing[k];
            let (low, high) = ((centre[k] - half).ceil().max(0.0), (centre[k] + half).floor());
            let high = high.min((grid.dims[k] - 1) as f64);
            if low > high {
                return None;
            }
            reach[k] = [low as u32, high as u32];
        }
        let whiten =
            DMat3::from_diagonal(1.0 / sigma) * axes.transpose() * DMat3::from_diagonal(DVec3::from(grid.spacing));
        whiten.is_finite().then_some(Self { label: cloud.labels[i] as u16, reach, opacity, centre, whiten })
    }

    /// Adds the density at the voxels of the row `(y, z)` to `row`, which holds all voxels along x.
    pub fn add_row(&self, y: usize, z: usize, row: &mut [f32]) {
        // Along the row the squared distance in standard deviations is a parabola `lowest + a (x - x0)^2`.
        let along = self.whiten.x_axis;
        let rest = self.whiten.y_axis * (y as f64 - self.centre.y) + self.whiten.z_axis * (z as f64 - self.centre.z);
        let (a, b) = (along.length_squared(), along.dot(rest));
        let offset = -b / a;
        let lowest = (rest + offset * along).length_squared();
        if lowest > CUT * CUT || lowest.is_nan() {
            return;
        }
        let (x0, half) = (self.centre.x + offset, ((CUT * CUT - lowest) / a).sqrt());
        let low = (x0 - half).ceil().max(f64::from(self.reach[0][0]));
        let high = (x0 + half).floor().min(f64::from(self.reach[0][1]));
        if low > high {
            return;
        }
        for x in low as usize..=high as usize {
            let d = x as f64 - x0;
            row[x] += self.opacity * ((-0.5 * (lowest + a * d * d)) as f32).exp();
        }
    }
}
