//! Tests of `kmeans` on synthetic blobs and non-finite input.

use super::*;
use proptest::prelude::*;
use volseggs_testing::generator;

/// Generates `per` points around each centre within a cube of half side `spread`, cycling through the centres.
pub(crate) fn blobs(centres: &[Vec<f32>], per: usize, spread: f32, seed: u64) -> Vec<f32> {
    let mut u = generator(seed);
    let mut points = Vec::new();
    for _ in 0..per {
        for centre in centres {
            points.extend(centre.iter().map(|c| c + (u() + u() - 1.0) * spread));
        }
    }
    points
}

pub(crate) fn corners(count: usize, dimensions: usize) -> Vec<Vec<f32>> {
    let mut u = generator(99);
    let mut centres: Vec<Vec<f32>> = Vec::new();
    while centres.len() < count {
        let next: Vec<f32> = (0..dimensions).map(|_| u()).collect();
        if centres.iter().all(|c| squared(c, &next) > 0.16) {
            centres.push(next);
        }
    }
    centres
}

#[test]
fn blobs_are_recovered_in_order_of_weight() {
    let centres = corners(4, 3);
    let points = blobs(&centres, 300, 0.05, 1);
    let weights: Vec<f32> = (0..1200).map(|i| 1.0 + (i % 4) as f32).collect();
    let fit = kmeans(&points, 3, &weights, &KMeansConfig::new(4), &mut generator(2)).unwrap();
    assert_eq!(fit.clusters(), 4);
    for (i, label) in fit.labels.iter().enumerate() {
        assert_eq!(*label as usize, 4 - i % 4);
    }
    assert!((fit.weights[0] - 1200.0).abs() < 1e-6);
    assert!(squared(&fit.centroids[..3], &centres[3]) < 1e-4);
}

#[test]
fn the_thread_count_never_changes_a_bit() {
    let points = blobs(&corners(5, 3), 4000, 0.3, 7);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| kmeans(&points, 3, &[], &KMeansConfig::new(5), &mut generator(3)).unwrap())
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn weights_pull_the_centroid_and_zero_weights_do_not() {
    let fit = kmeans(&[0.0, 1.0, 100.0], 1, &[3.0, 1.0, 0.0], &KMeansConfig::new(1), &mut generator(1)).unwrap();
    assert!((fit.centroids[0] - 0.25).abs() < 1e-6);
    assert_eq!(fit.labels, [1, 1, 1]);
}

#[test]
fn poison_points_are_ignored() {
    let points = [0.0, 0.0, f32::NAN, 0.0, 1.0, 1.0, f32::INFINITY, 1.0];
    let weights = [1.0, 1.0, f32::NAN, 1.0];
    let fit = kmeans(&points, 2, &weights, &KMeansConfig::new(2), &mut generator(1)).unwrap();
    assert_eq!((fit.labels[1], fit.labels[3]), (0, 0));
    assert!(fit.labels[0] > 0 && fit.labels[2] > 0 && fit.centroids.iter().all(|c| c.is_finite()));
}

#[test]
fn fewer_places_than_clusters_give_fewer_clusters() {
    let same = kmeans(&[0.5; 30], 3, &[], &KMeansConfig::new(4), &mut generator(1)).unwrap();
    assert_eq!((same.clusters(), same.distortion), (1, 0.0));
    assert!(same.labels.iter().all(|&l| l == 1));
    let one = kmeans(&[1.0, 2.0], 2, &[0.0], &KMeansConfig::new(3), &mut generator(1)).unwrap();
    assert_eq!(one.centroids, [1.0, 2.0]);
    // memory is allocated by the number of points, not by the number of clusters requested
    let many = kmeans(&[1.0, 2.0, 4.0], 1, &[], &KMeansConfig::new(usize::MAX), &mut generator(1)).unwrap();
    assert_eq!(many.clusters(), 3);
    assert!(memory(1_000_000, 3, 1_000_000) > 1 << 30 && memory(3, 1, usize::MAX) > 1 << 60);
    let none = kmeans(&[], 3, &[], &KMeansConfig::new(3), &mut generator(1)).unwrap();
    assert_eq!((none.clusters(), none.labels.len()), (0, 0));
}

#[test]
fn an_emptied_cluster_moves_to_the_farthest_point() {
    let data = KMeansPoints::gather(&[0.0, 1.0, 2.0, 50.0], 1, &[]);
    let mut labels = vec![u32::MAX; 4];
    let pass = data.pass(&[1.0, 1000.0], &mut labels);
    assert_eq!((pass.weights[1], pass.farthest.1), (0.0, 3));
    let two = KMeansConfig { restarts: 1, ..KMeansConfig::new(2) };
    assert_eq!(kmeans(&[0.0, 1.0, 2.0, 50.0], 1, &[], &two, &mut generator(4)).unwrap().clusters(), 2);
}

#[test]
fn wrong_input_is_named() {
    let config = KMeansConfig::new(2);
    let error = kmeans(&[0.0; 7], 3, &[], &config, &mut generator(1)).unwrap_err().to_string();
    assert!(error.contains("points") && error.contains('9'), "{error}");
    assert!(kmeans(&[0.0; 6], 3, &[1.0], &config, &mut generator(1)).is_err());
    assert!(kmeans(&[0.0; 6], 0, &[], &config, &mut generator(1)).is_err());
    assert!(kmeans(&[0.0; 6], 3, &[], &KMeansConfig::new(0), &mut generator(1)).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn each_point_has_its_nearest_centroid(seed in 0u64..1000, k in 1usize..6, d in 1usize..5) {
        let mut u = generator(seed);
        let points: Vec<f32> = (0..200 * d).map(|_| u()).collect();
        let fit = kmeans(&points, d, &[], &KMeansConfig::new(k), &mut generator(seed)).unwrap();
        prop_assert_eq!(fit.clusters(), k);
        prop_assert!(fit.weights.windows(2).all(|w| w[0] >= w[1]));
        for (row, label) in points.chunks_exact(d).zip(&fit.labels) {
            prop_assert_eq!(nearest(row, &fit.centroids, d).0 + 1, *label as usize);
        }
    }
}

#[test]
fn a_stopped_clustering_ends_at_once() {
    let points = vec![0.25; 300];
    let asked = std::cell::Cell::new(0);
    let goes_on = || {
        asked.set(asked.get() + 1);
        asked.get() < 3
    };
    let found = kmeans_while(&points, 3, &[], &KMeansConfig::new(50), &mut generator(1), &goes_on);
    assert_eq!((found.unwrap_err(), asked.get()), (PointsError::Stopped, 3));
}
