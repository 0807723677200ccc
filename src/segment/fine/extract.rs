//! Segments of a trained affinity field: clusters of features at a scale, and how alike features are.

use super::network::{AffinityField, FEATURES, Frame};
use crate::points::PointsError;
use crate::points::hdbscan::{Assignment, DensityConfig, cluster_features};
use crate::points::kmeans::{KMeansConfig, kmeans_while};
use crate::rng::{Purpose, Rng};
use rayon::prelude::*;

/// How features become clusters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clustering {
    /// By density; the number of clusters comes from the data.
    Density,
    /// Into so many.
    KMeans(usize),
}

/// Clusters the Gaussians with `means` `[M, 3]` by their features at `scale` in [0, 1]. Labels `[M]` from 1, the
/// largest cluster first. It goes on as long as `goes_on`, which is asked again and again.
///
/// # Errors
/// If an option is out of range; [`PointsError::Stopped`].
pub fn cluster(
    field: &AffinityField,
    frame: &Frame,
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

/// Cosines `[M]` of unit `features` `[M, 16]` with that of number `clicked`.
///
/// # Panics
/// If `clicked` is not below M.
#[must_use]
pub fn cosines(features: &[f32], clicked: usize) -> Vec<f32> {
    let of = &features[clicked * FEATURES..][..FEATURES];
    features.par_chunks_exact(FEATURES).map(|row| row.iter().zip(of).map(|(a, b)| a * b).sum()).collect()
}
