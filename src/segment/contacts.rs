//! Which Gaussians are in contact with which of their nearest neighbours.

use crate::model::HostGaussians;
use crate::points::PointsError;
use crate::points::chunks::point;
use crate::points::components::largest_scales;
use crate::points::neighbours::Grid;

/// Neighbours searched for contacts.
pub(super) const NEIGHBOURS: usize = 12;
/// Contact distance of two Gaussians, as a multiple of the sum of their largest standard deviations.
const REACH: f32 = 1.0;

/// The contacts among M Gaussians.
pub(super) struct Contacts {
    /// Positions `[M, 3]`, world units.
    pub means: Vec<f32>,
    /// Largest standard deviations `[M]`, world units.
    pub radii: Vec<f32>,
    nearest: Vec<[u32; NEIGHBOURS]>,
}

impl Contacts {
    /// Finds the contacts among the Gaussians `shown` (`[M]`, indices into `at`).
    ///
    /// # Errors
    /// If the arrays of `at` disagree.
    ///
    /// # Panics
    /// If an index is not below N.
    pub fn among(at: &HostGaussians, shown: &[u32]) -> Result<Self, PointsError> {
        let rows = |values: &[f32]| -> Vec<f32> { shown.iter().flat_map(|&i| point(values, i as usize)).collect() };
        let means = rows(&at.means);
        let nearest = Grid::adaptive(&means)?.nearest_of_each();
        Ok(Self { radii: largest_scales(&rows(&at.log_scales))?, means, nearest })
    }

    /// Returns the rows, of [`NEIGHBOURS`] at most, in contact with row `n`, from near to far.
    pub fn of(&self, n: usize) -> impl Iterator<Item = usize> {
        let others = self.nearest[n].iter().map(|&k| k as usize).filter(move |&k| k != n);
        others.filter(move |&k| self.within(n, k, REACH))
    }

    /// Returns whether two rows are within `reach` times the sum of their largest standard deviations.
    pub fn within(&self, n: usize, k: usize, reach: f32) -> bool {
        let limit = reach * (self.radii[n] + self.radii[k]);
        let square: f32 = (0..3).map(|a| (self.means[3 * n + a] - self.means[3 * k + a]).powi(2)).sum();
        square <= limit * limit
    }
}
