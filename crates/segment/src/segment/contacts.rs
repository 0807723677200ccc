//! Which Gaussians are in contact with which of their nearest neighbours.

use crate::config::types::segment::ContactsConfig;
use crate::model::HostGaussians;
use crate::points::PointsError;
use crate::points::chunks::point;
use crate::points::components::largest_scales;
use crate::points::neighbours::NeighbourGrid;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// M Gaussians that are searched for neighbours.
pub(super) struct Neighbourhood {
    /// Positions `[M, 3]`, scene units.
    means: Vec<f32>,
    /// Largest standard deviations `[M]`, scene units.
    radii: Vec<f32>,
    grid: NeighbourGrid,
}

impl Neighbourhood {
    /// Of Gaussians with these `means` `[M, 3]` and largest standard deviations `radii` `[M]`, scene units.
    ///
    /// # Errors
    /// If the means are not rows of three.
    pub fn new(means: Vec<f32>, radii: Vec<f32>) -> Result<Self, PointsError> {
        Ok(Self { grid: NeighbourGrid::adaptive(&means)?, means, radii })
    }

    /// Returns those of the `count` nearest neighbours of row `n` that are within `reach` times the sum of both largest
    /// standard deviations, from near to far; none for a row that is not finite.
    pub fn within(&self, n: usize, count: usize, reach: f32) -> impl Iterator<Item = usize> {
        let found = self.grid.nearest(point(&self.means, n), count, Some(n as u32)).into_iter();
        let limit = move |k: usize| reach * (self.radii[n] + self.radii[k]);
        found
            .map(|(k, square)| (k as usize, square))
            .filter(move |&(k, square)| square <= limit(k).powi(2))
            .map(|(k, _)| k)
    }

    /// Returns the position of row `n`, scene units.
    pub fn position(&self, n: usize) -> DVec3 {
        Vec3::from_array(point(&self.means, n)).as_dvec3()
    }

    /// Returns the Gaussians `rows` alone.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn subset(&self, rows: &[usize]) -> Result<Self, PointsError> {
        let means = rows.iter().flat_map(|&n| point(&self.means, n)).collect();
        Self::new(means, rows.iter().map(|&n| self.radii[n]).collect())
    }
}

/// The contacts among M Gaussians.
pub(super) struct Contacts {
    /// The Gaussians.
    pub all: Neighbourhood,
    touching: Vec<Vec<usize>>,
}

impl Contacts {
    /// Finds the contacts among the Gaussians `shown` (`[M]`, indices into `at`).
    ///
    /// # Errors
    /// If the arrays of `at` disagree.
    ///
    /// # Panics
    /// If an index is not below N.
    pub fn among(at: &HostGaussians, shown: &[u32], config: &ContactsConfig) -> Result<Self, PointsError> {
        let rows = |values: &[f32]| -> Vec<f32> { shown.iter().flat_map(|&i| point(values, i as usize)).collect() };
        let all = Neighbourhood::new(rows(&at.means), largest_scales(&rows(&at.log_scales))?)?;
        let touching = |n: usize| all.within(n, config.neighbours, config.reach).collect();
        let touching = (0..shown.len()).into_par_iter().map(touching).collect();
        Ok(Self { all, touching })
    }

    /// Returns the rows, of [`ContactsConfig::neighbours`] at most, in contact with row `n`, from near to far.
    pub fn touching(&self, n: usize) -> &[usize] {
        &self.touching[n]
    }
}
