//! One Gaussian in the index space of a grid: which cells it reaches and how much it adds along a row of x.

use super::Cloud;
use crate::volume::grid::Grid;
use glam::{DMat3, DQuat, DVec3};
use volseggs_kernels::bell_rows::{BellSection, add_bell, add_depth};
use volseggs_kernels::splat::ALPHA_MAX;

/// Standard deviations at which a Gaussian ends. The density there is 1/90 of its maximum.
const CUT: f64 = 3.0;

/// Opacity below which drawing skips a Gaussian.
pub const INVISIBLE: f32 = 1.0 / 255.0;

/// Returns the optical depth of a ray through the centre of a Gaussian of this linear opacity; drawing limits opacities
/// likewise.
pub fn depth(opacity: f32) -> f64 {
    -f64::from(-opacity.min(ALPHA_MAX)).ln_1p()
}

/// A Gaussian that is somewhere on a grid.
#[derive(Clone, Debug)]
pub struct Bell {
    /// Its index.
    pub index: u32,
    /// The label of its segment.
    pub label: u32,
    /// First and last cell of its box along x, y, z.
    pub reach: [[u32; 2]; 3],
    /// Its linear opacity, as drawing limits it.
    opacity: f32,
    /// The optical depth of a ray through its centre.
    depth: f32,
    /// Factor from optical depth to extinction density: one over the length of the path through its centre, less where
    /// it was widened.
    density: f32,
    /// Geometric mean of its standard deviations.
    pub size: f64,
    /// What it holds: its extinction density summed over space, `depth * 2 pi size^2`, an area.
    pub content: f64,
    centre: DVec3,
    /// Maps cells to standard deviations along the axes of the Gaussian.
    whiten: DMat3,
}

/// What a Gaussian adds at a place where its bell curve is `e`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BellProfile {
    /// `opacity e`.
    Opacity,
    /// Extinction density of the depth `-ln(1 - opacity e)`, with which it is drawn at that distance.
    Drawn,
    /// Extinction density of the depth `-ln(1 - opacity) e`: summed along any ray it is the depth at the ray's distance,
    /// summed over space the Gaussian's content.
    Content,
}

impl Bell {
    /// The Gaussian `i` with standard deviations of at least `smallest`, in the units of the grid, or `None` if it is
    /// invisible, degenerate or reaches no cell's centre.
    pub fn new(cloud: &Cloud<'_>, i: usize, grid: &Grid, smallest: f64) -> Option<Self> {
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
        let (mut sigma, mut product) = ([0.0; 3], 1.0);
        for (s, log) in sigma.iter_mut().zip(&cloud.log_scales[3 * i..3 * i + 3]) {
            let scale = log.exp();
            if !scale.is_normal() {
                return None;
            }
            product *= f64::from(scale);
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
        let size = product.cbrt();
        let depth = depth(opacity);
        let content = depth * std::f64::consts::TAU * size * size;
        let density = (size * size / (std::f64::consts::TAU.sqrt() * sigma.element_product())) as f32;
        let (label, opacity) = (cloud.labels[i], opacity.min(ALPHA_MAX));
        let depth = depth as f32;
        let found = Self { index: i as u32, label, reach, opacity, depth, density, size, content, centre, whiten };
        (whiten.is_finite() && density.is_finite()).then_some(found)
    }

    /// The same with `factor` times its density.
    #[must_use]
    pub fn times(self, factor: f32) -> Self {
        Self { density: factor * self.density, ..self }
    }

    /// The cell that holds its centre; `None` outside of the grid.
    pub fn cell(&self, dims: [usize; 3]) -> Option<usize> {
        let at = self.centre.round();
        let inside = (0..3).all(|k| at[k] >= 0.0 && at[k] < dims[k] as f64);
        inside.then(|| (at.z as usize * dims[1] + at.y as usize) * dims[0] + at.x as usize)
    }

    /// Adds the density at the cells `from..from + row.len()` of the row `(y, z)` to `row`.
    pub fn add_row(&self, profile: BellProfile, y: usize, z: usize, from: usize, row: &mut [f32]) {
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
        let cells = &mut row[low as usize - from..=high as usize - from];
        let section = BellSection { lowest: lowest as f32, curvature: a as f32, start: (low - x0) as f32 };
        match profile {
            BellProfile::Opacity => add_bell(cells, section, self.opacity),
            BellProfile::Drawn => add_depth(cells, section, self.opacity, self.density),
            BellProfile::Content => add_bell(cells, section, self.density * self.depth),
        }
    }
}
