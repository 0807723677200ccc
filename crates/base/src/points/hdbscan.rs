//! Density clustering of per-Gaussian features: HDBSCAN on a seeded sample, the rest assigned by cosine. The clustering
//! itself is done by the `hdbscan` crate.

use super::chunks::map_chunks;
use super::error::{PointsError, rows};
use super::sampling::sample_indices;
use hdbscan::{DistanceMetric, Hdbscan, HdbscanHyperParams, NnAlgorithm};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

/// Length of the random offset added to each sampled feature. Without it equal features lie at distance 0, where
/// HDBSCAN's density is infinite and its cluster stabilities are undefined.
const NUDGE: f32 = 1e-3;
/// Interval at which `goes_on` is called while waiting.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// What a Gaussian outside the sample is compared to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Assignment {
    /// The mean direction of each cluster: fast, suited to round clusters.
    Centre,
    /// Every labelled sample: handles clusters of any shape, costs `N * sample * D`.
    Sample,
}

/// Settings of [`cluster_features`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DensityConfig {
    /// Number of features given to HDBSCAN; its time grows with the square.
    pub sample: usize,
    /// Minimum number of sampled features in a cluster, at least 2.
    pub min_cluster_size: usize,
    /// Neighbours that define density, at least 1; higher values label more features as noise.
    pub min_samples: usize,
    /// Whether all features may form one cluster.
    pub single_cluster: bool,
    /// How features outside the sample are assigned.
    pub assignment: Assignment,
    /// Cosine below which a feature outside the sample is noise; -1 assigns all.
    pub min_similarity: f32,
    /// Whether sampled features that HDBSCAN labels as noise stay noise, rather than being assigned like the rest.
    pub keep_noise: bool,
}

impl Default for DensityConfig {
    fn default() -> Self {
        Self {
            sample: 5000,
            min_cluster_size: 50,
            min_samples: 10,
            single_cluster: false,
            assignment: Assignment::Centre,
            min_similarity: -1.0,
            keep_noise: false,
        }
    }
}

/// The outcome of [`cluster_features`].
#[derive(Debug, Clone, PartialEq)]
pub struct DensityClusters {
    /// `[N]`: 0 for noise and unusable features; clusters from 1, the one with the most Gaussians first.
    pub labels: Vec<u32>,
    /// `[C, D]`: unit mean direction of each cluster's samples.
    pub centres: Vec<f32>,
    /// `[C]`: number of Gaussians in each cluster.
    pub counts: Vec<u32>,
}

/// Clusters `features` `[N, dimensions]` by direction; they are normalised here.
///
/// A seeded sample is clustered by HDBSCAN (Euclidean distance between unit vectors, which orders as the cosine does)
/// and the rest is assigned by cosine. Features that are zero or not finite get label 0. Where HDBSCAN finds no
/// cluster, or there are too few features for one, all labels are 0.
///
/// Stops when `goes_on`, which is called repeatedly, returns false.
///
/// # Errors
/// `features` not a whole number of rows; `min_cluster_size` below 2 or `min_samples` below 1;
/// [`PointsError::Stopped`].
pub fn cluster_features(
    features: &[f32],
    dimensions: usize,
    config: &DensityConfig,
    uniform: &mut impl FnMut() -> f32,
    goes_on: &dyn Fn() -> bool,
) -> Result<DensityClusters, PointsError> {
    let count = rows("features", features.len(), dimensions, "[N, D]")?;
    for (field, value, minimum) in
        [("min_cluster_size", config.min_cluster_size, 2), ("min_samples", config.min_samples, 1)]
    {
        if value < minimum {
            let want = if minimum == 2 { "at least 2" } else { "at least 1" };
            return Err(PointsError::Setting { field, value: value.to_string(), want });
        }
    }
    let unit = normalised(features, dimensions);
    let row = |i: usize| &unit[i * dimensions..(i + 1) * dimensions];
    let usable: Vec<u32> = (0..count as u32).filter(|&i| !row(i as usize)[0].is_nan()).collect();
    let picked = sample_indices(usable.len(), config.sample, uniform);
    let sample: Vec<u32> = picked.into_iter().map(|p| usable[p as usize]).collect();
    let nudge = NUDGE * 2.0 * (3.0 / dimensions as f32).sqrt();
    let vectors: Vec<Vec<f32>> =
        sample.iter().map(|&i| row(i as usize).iter().map(|v| v + nudge * (uniform() - 0.5)).collect()).collect();
    let found = run(vectors, config, goes_on)?;
    let clusters = found.iter().max().map_or(0, |&m| (m + 1).max(0) as usize);
    if clusters == 0 {
        return Ok(DensityClusters { labels: vec![0; count], centres: Vec::new(), counts: Vec::new() });
    }
    let mut sums = vec![0f64; clusters * dimensions];
    for (&i, &label) in sample.iter().zip(&found).filter(|(_, l)| **l >= 0) {
        for (sum, v) in sums[label as usize * dimensions..].iter_mut().zip(row(i as usize)) {
            *sum += f64::from(*v);
        }
    }
    let centres = normalised(&sums.iter().map(|&s| s as f32).collect::<Vec<f32>>(), dimensions);
    let (references, reference_labels): (Vec<f32>, Vec<u32>) = match config.assignment {
        Assignment::Centre => (centres.clone(), (1..=clusters as u32).collect()),
        Assignment::Sample => {
            let labelled = || sample.iter().zip(&found).filter(|(_, l)| **l >= 0);
            let rows = labelled().flat_map(|(&i, _)| row(i as usize).to_vec()).collect();
            (rows, labelled().map(|(_, &l)| l as u32 + 1).collect())
        }
    };
    let mut sampled: Vec<Option<u32>> = vec![None; count];
    for (&i, &label) in sample.iter().zip(&found) {
        if label >= 0 || config.keep_noise {
            sampled[i as usize] = Some((label + 1).max(0) as u32);
        }
    }
    let labels = map_chunks(count, |range| {
        range
            .map(|i| match sampled[i] {
                Some(label) => label,
                None => match most_similar(row(i), &references, dimensions) {
                    Some((best, cosine)) if cosine >= config.min_similarity => reference_labels[best],
                    _ => 0,
                },
            })
            .collect::<Vec<u32>>()
    })
    .concat();
    Ok(by_size(labels, &centres, dimensions, clusters))
}

/// Runs HDBSCAN on the sample: -1 for noise, else a cluster from 0. Single-threaded, because the crate's parallel tree
/// does not guarantee the same choice among equal distances. The crate cannot be stopped, so once stopped its thread is
/// left to finish on its own.
fn run(vectors: Vec<Vec<f32>>, config: &DensityConfig, goes_on: &dyn Fn() -> bool) -> Result<Vec<i32>, PointsError> {
    let samples = vectors.len();
    if samples < config.min_cluster_size.max(3) {
        return Ok(vec![-1; samples]);
    }
    let settings = HdbscanHyperParams::builder()
        .min_cluster_size(config.min_cluster_size)
        .min_samples(config.min_samples.min(samples))
        .allow_single_cluster(config.single_cluster)
        .dist_metric(DistanceMetric::Euclidean)
        .nn_algorithm(NnAlgorithm::Auto)
        .build();
    let failed = |reason: String| PointsError::Clustering { samples, reason };
    let (out, found) = channel();
    let work = move || {
        let labels = Hdbscan::new(&vectors, settings).cluster().map_err(|e| e.to_string());
        // if stopped, nobody is listening any more
        let _ = out.send(labels);
    };
    std::thread::Builder::new().name("clusters".into()).spawn(work).map_err(|e| failed(e.to_string()))?;
    loop {
        match found.recv_timeout(POLL_INTERVAL) {
            Ok(labels) => return labels.map_err(failed),
            Err(RecvTimeoutError::Timeout) if goes_on() => {}
            Err(RecvTimeoutError::Timeout) => return Err(PointsError::Stopped),
            Err(RecvTimeoutError::Disconnected) => return Err(failed("its thread ended".into())),
        }
    }
}

/// Rows scaled to length 1; rows that are zero or not finite become NaN.
fn normalised(features: &[f32], dimensions: usize) -> Vec<f32> {
    let count = features.len() / dimensions;
    map_chunks(count, |range| {
        let mut out = Vec::with_capacity(range.len() * dimensions);
        for row in features[range.start * dimensions..range.end * dimensions].chunks_exact(dimensions) {
            let length = row.iter().map(|&v| f64::from(v) * f64::from(v)).sum::<f64>().sqrt();
            let good = length.is_finite() && length > 0.0;
            out.extend(row.iter().map(|&v| if good { (f64::from(v) / length) as f32 } else { f32::NAN }));
        }
        out
    })
    .concat()
}

/// Returns the reference of largest cosine, the first among equals; `None` for a NaN row.
fn most_similar(row: &[f32], references: &[f32], dimensions: usize) -> Option<(usize, f32)> {
    let mut best = None;
    for (r, reference) in references.chunks_exact(dimensions).enumerate() {
        let cosine = dot(row, reference);
        if !cosine.is_nan() && best.is_none_or(|(_, c)| cosine > c) {
            best = Some((r, cosine));
        }
    }
    best
}

/// The inner product in eight running sums, which the compiler can keep in vector registers.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0f32; 8];
    let (a8, b8) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f32 = a8.remainder().iter().zip(b8.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in a8.zip(b8) {
        for j in 0..8 {
            sums[j] += x[j] * y[j];
        }
    }
    rest + sums.iter().sum::<f32>()
}

/// Renumbers clusters by the number of Gaussians they hold.
fn by_size(mut labels: Vec<u32>, centres: &[f32], dimensions: usize, clusters: usize) -> DensityClusters {
    let mut counts = vec![0u32; clusters + 1];
    labels.iter().for_each(|&l| counts[l as usize] += 1);
    let mut order: Vec<usize> = (1..=clusters).collect();
    order.sort_by_key(|&l| (std::cmp::Reverse(counts[l]), l));
    let mut renamed = vec![0u32; clusters + 1];
    for (rank, &old) in order.iter().enumerate() {
        renamed[old] = rank as u32 + 1;
    }
    labels.iter_mut().for_each(|l| *l = renamed[*l as usize]);
    DensityClusters {
        labels,
        centres: order.iter().flat_map(|&l| centres[(l - 1) * dimensions..l * dimensions].to_vec()).collect(),
        counts: order.iter().map(|&l| counts[l]).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::kmeans::tests::blobs;
    use volseggs_testing::generator;

    fn axes(count: usize, dimensions: usize) -> Vec<Vec<f32>> {
        (0..count).map(|c| (0..dimensions).map(|d| if c == d { 1.0 } else { 0.0 }).collect()).collect()
    }

    fn small() -> DensityConfig {
        DensityConfig { sample: 400, min_cluster_size: 20, min_samples: 5, ..DensityConfig::default() }
    }

    #[test]
    fn directions_are_clustered_whatever_their_length() {
        let mut features = blobs(&axes(4, 16), 300, 0.1, 2);
        features.iter_mut().enumerate().for_each(|(i, v)| *v *= 1.0 + (i / 16 % 7) as f32);
        for assignment in [Assignment::Centre, Assignment::Sample] {
            let found =
                cluster_features(&features, 16, &DensityConfig { assignment, ..small() }, &mut generator(3), &|| true);
            let found = found.unwrap();
            assert_eq!(found.counts, [300; 4]);
            assert!((0..1200).all(|i| found.labels[i] == found.labels[i % 4]));
            assert_eq!(found.centres.len(), 64);
        }
    }

    #[test]
    fn strays_can_be_kept_as_noise() {
        let mut features = blobs(&axes(2, 8), 400, 0.05, 2);
        features.extend([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0]);
        let config = DensityConfig { min_similarity: 0.5, keep_noise: true, sample: 300, ..small() };
        let found = cluster_features(&features, 8, &config, &mut generator(3), &|| true).unwrap();
        assert_eq!(found.labels[800], 0);
        assert_eq!(found.counts.len(), 2);
        let all =
            cluster_features(&features, 8, &DensityConfig { sample: 300, ..small() }, &mut generator(3), &|| true)
                .unwrap();
        assert!(all.labels.iter().all(|&l| l > 0));
    }

    #[test]
    fn equal_features_do_not_break_the_stabilities() {
        let features: Vec<f32> =
            (0..300).flat_map(|i| if i % 3 == 0 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] }).collect();
        let found = cluster_features(&features, 3, &small(), &mut generator(3), &|| true).unwrap();
        assert_eq!(found.counts, [200, 100]);
    }

    #[test]
    fn poison_features() {
        let config = small();
        let none = cluster_features(&[], 16, &config, &mut generator(1), &|| true).unwrap();
        assert!(none.labels.is_empty() && none.counts.is_empty());
        assert_eq!(cluster_features(&[1.0; 16], 16, &config, &mut generator(1), &|| true).unwrap().labels, [0]);
        assert_eq!(
            cluster_features(&[f32::NAN; 160], 16, &config, &mut generator(1), &|| true).unwrap().labels,
            [0; 10]
        );
        let mut features = blobs(&axes(2, 4), 100, 0.05, 2);
        features[..8].copy_from_slice(&[0.0, 0.0, 0.0, 0.0, f32::NAN, 1.0, 0.0, 0.0]);
        let found = cluster_features(&features, 4, &config, &mut generator(1), &|| true).unwrap();
        assert_eq!((found.labels[0], found.labels[1], found.counts.as_slice()), (0, 0, &[99, 99][..]));
        let same = cluster_features(&[0.5; 800], 4, &config, &mut generator(1), &|| true).unwrap();
        assert_eq!(same.labels.len(), 200);
        let few = DensityConfig { min_samples: 500, ..config };
        assert_eq!(cluster_features(&features, 4, &few, &mut generator(1), &|| true).unwrap().labels.len(), 200);
        assert!(cluster_features(&[0.0; 5], 4, &config, &mut generator(1), &|| true).is_err());
        assert!(
            cluster_features(&[0.0; 4], 4, &DensityConfig { min_samples: 0, ..config }, &mut generator(1), &|| true)
                .is_err()
        );
    }

    #[test]
    fn a_stopped_clustering_is_not_waited_for() {
        let features = blobs(&axes(4, 16), 1000, 0.3, 2);
        let config = DensityConfig { sample: 4000, ..DensityConfig::default() };
        let started = std::time::Instant::now();
        let found = cluster_features(&features, 16, &config, &mut generator(1), &|| false);
        assert_eq!(found.unwrap_err(), PointsError::Stopped);
        let stopped = started.elapsed();
        assert!(cluster_features(&features, 16, &config, &mut generator(1), &|| true).is_ok());
        assert!(stopped < started.elapsed() / 4, "{stopped:?} of {:?}", started.elapsed());
    }

    #[test]
    fn the_thread_count_never_changes_a_label() {
        let features = blobs(&axes(5, 16), 1500, 0.3, 2);
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| cluster_features(&features, 16, &small(), &mut generator(3), &|| true).unwrap())
        };
        assert_eq!(run(1), run(3));
    }
}
