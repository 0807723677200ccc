//! Features of Gaussians averaged over their neighbours: lists of neighbours, and the mean as a sparse matrix. Nothing
//! is learnt here.

use super::loss::{FEATURES, Feature, unit};
use crate::points::PointsError;
use crate::points::neighbours::Grid;
use rayon::prelude::*;
use volseggs_kernels::splat::contributors::Contributors;

/// The nearest neighbours of N Gaussians, each Gaussian itself first, then from near to far.
#[derive(Clone, Debug)]
pub(super) struct Neighbours {
    /// `[N, per]`; missing neighbours are replaced by the Gaussian itself.
    ids: Vec<u32>,
    per: usize,
}

impl Neighbours {
    /// Finds `per` neighbours of each of `means` `[N, 3]`. A Gaussian without a finite position is its own only
    /// neighbour.
    pub(super) fn new(means: &[f32], per: usize) -> Result<Self, PointsError> {
        let grid = Grid::adaptive(means)?;
        let row = |i: u32| {
            let mean = &means[3 * i as usize..][..3];
            let found = grid.nearest([mean[0], mean[1], mean[2]], per - 1, Some(i));
            let near = found.into_iter().map(|(id, _)| id).chain(std::iter::repeat(i)).take(per - 1);
            std::iter::once(i).chain(near).collect::<Vec<u32>>()
        };
        let ids = (0..means.len() as u32 / 3).into_par_iter().flat_map_iter(row).collect();
        Ok(Self { ids, per })
    }

    /// Number of neighbours of each Gaussian, including itself.
    pub(super) fn per(&self) -> usize {
        self.per
    }

    /// Neighbours of Gaussian `i`, including itself.
    pub(super) fn of(&self, i: u32) -> &[u32] {
        &self.ids[i as usize * self.per..][..self.per]
    }
}

/// Returns the averaging matrix: each row has the next `per` of `indices`, each with weight `1 / per`.
pub(super) fn means_of(indices: Vec<u32>, per: usize) -> Contributors {
    let offsets = (0..=indices.len() as u32).step_by(per).collect();
    let weights = vec![1.0 / per as f32; indices.len()];
    Contributors { offsets, indices, weights }
}

/// Returns the directions and lengths of rows `[R, 32]`.
pub(super) fn directions(rows: &[f32]) -> Vec<(Feature, f32)> {
    rows.par_chunks_exact(FEATURES).map(|row| unit(std::array::from_fn(|k| row[k]))).collect()
}

/// Returns the directions alone, `[R, 32]` flat.
pub(super) fn flat(rows: &[(Feature, f32)]) -> Vec<f32> {
    rows.par_iter().flat_map_iter(|row| row.0).collect()
}
