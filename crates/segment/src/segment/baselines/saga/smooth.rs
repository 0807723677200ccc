//! Features of Gaussians averaged over their neighbours, the mean as a sparse matrix. Nothing is learnt here.

use super::loss::{FEATURES, Feature, unit};
use crate::points::nearest_rows::NearestRows;
use rayon::prelude::*;
use volseggs_kernels::splat::contributors::Contributors;

/// Returns the Gaussian `i`, then its neighbours from near to far; it takes the places of missing ones.
pub(super) fn with_neighbours(neighbours: &NearestRows, i: u32) -> impl Iterator<Item = u32> {
    std::iter::once(i).chain(neighbours.row(i as usize).iter().copied())
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
