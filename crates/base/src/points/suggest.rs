//! Estimates the number of clusters. The clustering itself lives in `kmeans`.

use super::error::{PointsError, check_len, rows};
use super::kmeans::{KMeans, KMeansConfig, kmeans, squared};
use super::sampling::sample_indices;
use std::ops::RangeInclusive;

/// Maximum number of points judged; larger sets are sampled down to this many.
const SAMPLE: usize = 8000;

/// The suggested number of clusters, with the score of each candidate.
#[derive(Debug, Clone, PartialEq)]
pub struct ClusterSuggestion {
    /// The suggested number.
    pub clusters: usize,
    /// Each candidate number and its score in -1..=1; higher is better.
    pub scores: Vec<(usize, f64)>,
}

/// Suggests the number of clusters in `points` `[N, dimensions]` with weights `[N]` (empty for equal weights), by the
/// simplified weighted silhouette.
///
/// Each candidate (2..=10 is a good range) is clustered on a seeded sample of at most 8,000 points; a point at distance
/// `a` from its own centroid and `b` from the next one scores `(b - a) / b`, and the candidate scores the weighted
/// mean. The best score wins, the smaller number among equals. A silhouette cannot judge a single cluster: 1 is
/// suggested only where no candidate splits the points (all at one position, one point, none).
///
/// # Errors
/// Slices of the wrong length; an empty range or one that starts at 0.
pub fn suggest_clusters(
    points: &[f32],
    dimensions: usize,
    weights: &[f32],
    candidates: RangeInclusive<usize>,
    uniform: &mut impl FnMut() -> f32,
) -> Result<ClusterSuggestion, PointsError> {
    let count = rows("points", points.len(), dimensions, "[N, D]")?;
    if !weights.is_empty() {
        check_len("weights", weights.len(), count, "[N]")?;
    }
    if candidates.is_empty() || *candidates.start() == 0 {
        let value = format!("{candidates:?}");
        return Err(PointsError::Setting { field: "candidates", value, want: "a range such as 2..=10" });
    }
    let usable: Vec<usize> = (0..count).filter(|&i| row(points, dimensions, i).iter().all(|v| v.is_finite())).collect();
    let picked = sample_indices(usable.len(), SAMPLE, uniform);
    let mut sample = Vec::with_capacity(picked.len() * dimensions);
    let mut sample_weights = Vec::with_capacity(picked.len());
    for i in picked.into_iter().map(|p| usable[p as usize]) {
        sample.extend_from_slice(row(points, dimensions, i));
        sample_weights.push(weights.get(i).map_or(1.0, |w| if w.is_finite() { w.max(0.0) } else { 0.0 }));
    }
    if sample_weights.iter().all(|&w| w == 0.0) {
        sample_weights.fill(1.0);
    }
    let mut best = (1, 0.0);
    let mut scores = Vec::new();
    for k in candidates {
        let fit = kmeans(&sample, dimensions, &sample_weights, &KMeansConfig::new(k), uniform)?;
        let score = silhouette(&sample, &sample_weights, &fit);
        if fit.clusters() == k && score > best.1 {
            best = (k, score);
        }
        scores.push((k, score));
    }
    Ok(ClusterSuggestion { clusters: best.0, scores })
}

fn row(points: &[f32], dimensions: usize, i: usize) -> &[f32] {
    &points[i * dimensions..(i + 1) * dimensions]
}

/// The simplified weighted silhouette, 0 for fewer than two clusters.
fn silhouette(points: &[f32], weights: &[f32], fit: &KMeans) -> f64 {
    if fit.clusters() < 2 {
        return 0.0;
    }
    let (mut sum, mut total) = (0.0, 0.0);
    for (point, &weight) in points.chunks_exact(fit.dimensions).zip(weights) {
        let (mut own, mut next) = (f32::INFINITY, f32::INFINITY);
        for centre in fit.centroids.chunks_exact(fit.dimensions) {
            let distance = squared(point, centre);
            if distance < own {
                (own, next) = (distance, own);
            } else {
                next = next.min(distance);
            }
        }
        let (own, next) = (f64::from(own).sqrt(), f64::from(next).sqrt());
        if next > 0.0 {
            sum += f64::from(weight) * (next - own) / next;
        }
        total += f64::from(weight);
    }
    if total > 0.0 { sum / total } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::kmeans::tests::{blobs, corners};
    use volseggs_testing::generator;

    #[test]
    fn the_number_of_blobs_is_found() {
        for (count, dimensions) in [(2, 3), (3, 3), (5, 3), (3, 8), (5, 16)] {
            let points = blobs(&corners(count, dimensions), 200, 0.1, 4);
            let found = suggest_clusters(&points, dimensions, &[], 2..=10, &mut generator(5)).unwrap();
            assert_eq!(found.clusters, count, "{:?}", found.scores);
            assert_eq!(found.scores.len(), 9);
        }
    }

    #[test]
    fn weights_hide_a_transparent_blob() {
        let points = blobs(&corners(4, 3), 200, 0.05, 4);
        let weights: Vec<f32> = (0..800).map(|i| if i % 4 == 3 { 0.0 } else { 1.0 }).collect();
        assert_eq!(suggest_clusters(&points, 3, &weights, 2..=10, &mut generator(5)).unwrap().clusters, 3);
    }

    #[test]
    fn points_without_structure_in_them_get_one_cluster() {
        for points in [vec![], vec![1.0, 2.0, 3.0], vec![0.25; 300], vec![f32::NAN; 30]] {
            assert_eq!(suggest_clusters(&points, 3, &[], 2..=10, &mut generator(5)).unwrap().clusters, 1);
        }
    }

    #[test]
    fn a_candidate_range_must_make_sense() {
        assert!(suggest_clusters(&[0.0; 9], 3, &[], 0..=4, &mut generator(5)).is_err());
        #[expect(clippy::reversed_empty_ranges)]
        let empty = 4..=2;
        assert!(suggest_clusters(&[0.0; 9], 3, &[], empty, &mut generator(5)).is_err());
    }
}
