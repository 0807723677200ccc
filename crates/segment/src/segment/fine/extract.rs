//! Segments from a trained affinity field: clusters of features at a scale, and cosines between features.

use super::network::{AffinityField, FEATURES, PositionBox};
use crate::points::PointsError;
use crate::points::hdbscan::{Assignment, DensityConfig, cluster_features};
use crate::points::kmeans::{KMeansConfig, kmeans_while};
use crate::rng::{Purpose, Rng};
use rayon::prelude::*;

/// How features are clustered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clustering {
    /// By density; the number of clusters follows from the data.
    Density,
    /// By k-means, into this many clusters.
    KMeans(usize),
}

/// Clusters the Gaussians with `means` `[M, 3]` by their features at `scale` in [0, 1]. Returns labels `[M]` from 1,
/// the largest cluster first. `goes_on` is polled throughout and stops the clustering by `false`.
///
/// # Errors
/// If an option is out of range; [`PointsError::Stopped`].
pub fn cluster(
    field: &AffinityField,
    frame: &PositionBox,
    means: &[f32],
    scale: f32,
    clustering: Clustering,
    seed: u64,
    goes_on: &dyn Fn() -> bool,
) -> Result<Vec<u32>, PointsError> {
    let features = field.features(&frame.encode(means), scale);
    let mut rng = Rng::new(seed, 1, Purpose::Clusters);
    let mut uniform = || rng.uniform();
    match clustering {
        Clustering::Density => {
            let config = DensityConfig { assignment: Assignment::Centre, ..DensityConfig::default() };
            Ok(cluster_features(&features, FEATURES, &config, &mut uniform, goes_on)?.labels)
        }
        Clustering::KMeans(k) => {
            let weights = vec![1.0; features.len() / FEATURES];
            Ok(kmeans_while(&features, FEATURES, &weights, &KMeansConfig::new(k), &mut uniform, goes_on)?.labels)
        }
    }
}

/// Returns the cosines `[M]` of unit `features` `[M, 16]` with that of number `clicked`.
///
/// # Panics
/// If `clicked` is not below M.
pub fn cosines(features: &[f32], clicked: usize) -> Vec<f32> {
    let of = &features[clicked * FEATURES..][..FEATURES];
    features.par_chunks_exact(FEATURES).map(|row| row.iter().zip(of).map(|(a, b)| a * b).sum()).collect()
}
