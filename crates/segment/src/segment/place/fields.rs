//! Fields on a grid: the extinction density of Gaussians, and averages of their values weighted by it.
//!
//! The density is that of [`BellProfile::Content`](super::bell::BellProfile::Content), the optical depth per length of
//! a path:
//!
//! ```text
//! density(x) = sum_i s_i^2 / (sqrt(2 pi) a_i b_i c_i) tau_i exp(-d_i(x)^2 / 2)     tau_i = -ln(1 - opacity_i)
//! ```
//!
//! with the distance `d_i` from the centre of Gaussian `i` in its standard deviations `a_i, b_i, c_i`, and `s_i` their
//! geometric mean. Summed over space it is the Gaussian's content.

use super::bell::Bell;
use super::density::{bells, content};
use super::{Cloud, PlaceError};
use crate::volume::grid::Grid;

/// The density of Gaussians on a grid, and what averages weighted by it need.
#[derive(Debug)]
pub struct DensityFields {
    dims: [usize; 3],
    /// The Gaussians that reach the grid, by index.
    bells: Vec<Bell>,
    /// `[z, y, x]`, x fastest, per length in the units of the grid.
    pub density: Vec<f32>,
}

impl DensityFields {
    /// Scatters the density of Gaussians to the centres of cells; their labels do not matter. Gaussians with a
    /// non-finite number, a quaternion of length 0, or a scale beyond single precision do not count. One that is thinner
    /// than half a cell is widened to it, with the same integral.
    ///
    /// # Errors
    /// [`PlaceError`]: arrays that disagree, or an impossible grid.
    pub fn new(cloud: &Cloud<'_>, grid: &Grid) -> Result<Self, PlaceError> {
        super::check(cloud, grid)?;
        let bells = bells(cloud, grid, super::smallest(grid));
        let density = content(&bells, grid.dims);
        Ok(Self { dims: grid.dims, bells, density })
    }

    /// The average of one value of each Gaussian `[N]`, weighted by density, `[z, y, x]`; 0 where the density is 0. A
    /// value that is not finite counts as 0.
    pub fn average(&self, value: impl Fn(usize) -> f32) -> Vec<f32> {
        let scaled = self.bells.iter().map(|bell| {
            let value = value(bell.index as usize);
            bell.clone().times(if value.is_finite() { value } else { 0.0 })
        });
        let mut sum = content(&scaled.collect::<Vec<_>>(), self.dims);
        for (sum, density) in sum.iter_mut().zip(&self.density) {
            *sum = if *density > 0.0 { *sum / density } else { 0.0 };
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// One Gaussian in the middle of a grid of `n`^3 cells of side 0.1.
    fn one(n: usize, log_scales: [f32; 3], opacity: f32) -> (DensityFields, f64) {
        let half = 0.05 * (n - 1) as f64;
        let cloud = Cloud {
            means: &[0.0; 3],
            rotations: &[0.8, 0.2, -0.4, 0.4],
            log_scales: &log_scales,
            opacity: &[opacity],
            labels: &[0],
        };
        (DensityFields::new(&cloud, &Grid::aligned([n; 3], [0.1; 3], [-half; 3])).unwrap(), 0.1f64.powi(3))
    }

    #[test]
    fn a_gaussian_has_its_integral_and_its_optical_depth() {
        for (sigma, opacity) in [([0.5f64, 0.5, 0.5], 0.3f32), ([0.6, 0.3, 0.4], 0.9), ([0.01, 0.5, 0.5], 0.5)] {
            let (fields, cell) = one(61, sigma.map(|s| s.ln() as f32), opacity);
            let tau = -(1.0 - f64::from(opacity)).ln();
            let size = sigma.iter().product::<f64>().cbrt();
            // 2.9 % of a Gaussian lie beyond three standard deviations, where it ends
            let expected = 0.9707 * TAU * tau * size * size;
            let integral = cell * fields.density.iter().map(|v| f64::from(*v)).sum::<f64>();
            assert!((integral / expected - 1.0).abs() < 0.01, "{sigma:?}: {integral} {expected}");
        }
        let (fields, _) = one(61, [(0.5f64).ln() as f32; 3], 0.3);
        let depth: f64 = (0..61).map(|x| 0.1 * f64::from(fields.density[(30 * 61 + 30) * 61 + x])).sum();
        assert!((depth / -(0.7f64).ln() - 1.0).abs() < 0.01, "{depth}");
        let none = one(5, [0.0; 3], 0.001).0;
        assert!(none.density.iter().all(|v| *v == 0.0) && none.average(|_| 3.0).iter().all(|v| *v == 0.0));
    }

    #[test]
    fn averages_are_weighted_by_density_whatever_the_thread_count() {
        let grid = Grid::aligned([40, 9, 9], [0.1; 3], [0.0; 3]);
        let cloud = Cloud {
            means: &[0.8, 0.4, 0.4, 1.6, 0.4, 0.4],
            rotations: &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
            log_scales: &[(0.2f32).ln(); 6],
            opacity: &[0.4, 0.4],
            labels: &[0, 0],
        };
        let average = || DensityFields::new(&cloud, &grid).unwrap().average(|i| [-2.0, f32::NAN, 4.0][2 * i]);
        let found = average();
        let at = |x: usize| found[(4 * 9 + 4) * 40 + x];
        assert_eq!((at(3), at(21), at(39)), (-2.0, 4.0, 0.0));
        // in the middle between the two
        assert!((at(12) - 1.0).abs() < 1e-3, "{}", at(12));
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert_eq!(one.install(average), found);
    }
}
