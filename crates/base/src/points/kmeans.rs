//! Weighted k-means with k-means++ seeding for points of any dimension. Choosing the number of clusters lives in
//! `suggest`; colours and names live elsewhere.

use super::chunks::CHUNK;
use super::error::{PointsError, check_len, rows};
use super::sampling::fine_uniform;
use crate::memory::product;
use rayon::prelude::*;

/// Settings of [`kmeans`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KMeansConfig {
    /// Clusters wanted, at least 1.
    pub clusters: usize,
    /// Independent seedings, at least 1; the one of lowest distortion is kept.
    pub restarts: usize,
    /// Maximum number of Lloyd iterations per seeding.
    pub max_iterations: usize,
    /// Stops when an iteration lowers the distortion by less than this fraction; 0 continues until no label changes.
    pub tolerance: f64,
}

impl KMeansConfig {
    /// `clusters` clusters, 4 seedings, at most 100 iterations, tolerance 1e-6.
    pub fn new(clusters: usize) -> Self {
        Self { clusters, restarts: 4, max_iterations: 100, tolerance: 1e-6 }
    }
}

/// The outcome of [`kmeans`].
#[derive(Debug, Clone, PartialEq)]
pub struct KMeans {
    /// Number of columns of a point.
    pub dimensions: usize,
    /// `[K, D]`, heaviest cluster first; K is below the requested number where the points hold fewer distinct
    /// positions.
    pub centroids: Vec<f32>,
    /// `[N]`: 1 + row of the nearest centroid; 0 for points with a non-finite coordinate.
    pub labels: Vec<u32>,
    /// `[K]`: total weight of each cluster.
    pub weights: Vec<f64>,
    /// Sum over the points of weight times squared distance to the centroid.
    pub distortion: f64,
}

impl KMeans {
    /// Number of clusters.
    pub fn clusters(&self) -> usize {
        self.weights.len()
    }
}

/// Bytes that [`kmeans`] needs beside its input for `count` points; the per-chunk sums dominate.
pub fn memory(count: usize, dimensions: usize, clusters: usize) -> u128 {
    let sums = product(&[count.div_ceil(CHUNK), clusters, dimensions + 1, size_of::<f64>()]);
    // points, centroids, labels and distances
    sums.saturating_add(product(&[count.max(clusters), dimensions + 6, size_of::<f32>()]))
}

/// Clusters `points` `[N, dimensions]` with weights `[N]` (opacity; empty for equal weights).
///
/// Seeding draws in proportion to weight times squared distance (k-means++). A cluster that loses all its weight is
/// moved to the point of largest weighted squared distance. Sums run in double precision over fixed chunks merged in
/// order, so the result is bit-identical for any number of threads. Weights that are negative or not finite count as 0;
/// if all are 0, all points weigh the same. Points of weight 0 get a label but do not affect the centroids.
///
/// # Errors
/// Slices of the wrong length; `clusters` or `restarts` of 0.
pub fn kmeans(
    points: &[f32],
    dimensions: usize,
    weights: &[f32],
    config: &KMeansConfig,
    uniform: &mut impl FnMut() -> f32,
) -> Result<KMeans, PointsError> {
    kmeans_while(points, dimensions, weights, config, uniform, &|| true)
}

/// Like [`kmeans`], but stops when `goes_on`, which is called repeatedly, returns false.
///
/// # Errors
/// As for [`kmeans`], and [`PointsError::Stopped`].
pub fn kmeans_while(
    points: &[f32],
    dimensions: usize,
    weights: &[f32],
    config: &KMeansConfig,
    uniform: &mut impl FnMut() -> f32,
    goes_on: &dyn Fn() -> bool,
) -> Result<KMeans, PointsError> {
    let count = rows("points", points.len(), dimensions, "[N, D]")?;
    if !weights.is_empty() {
        check_len("weights", weights.len(), count, "[N]")?;
    }
    for (field, value) in [("clusters", config.clusters), ("restarts", config.restarts)] {
        if value == 0 {
            return Err(PointsError::Setting { field, value: "0".into(), want: "at least 1" });
        }
    }
    let data = KMeansPoints::gather(points, dimensions, weights);
    let mut best: Option<KMeansFit> = None;
    for _ in 0..config.restarts {
        let fit = data.fit(config, uniform, goes_on)?;
        if best.as_ref().is_none_or(|b| fit.distortion < b.distortion) {
            best = Some(fit);
        }
    }
    let fit = best.unwrap_or_default();
    Ok(data.finish(fit, count))
}

/// Returns an error once `goes_on` returns false.
fn check(goes_on: &dyn Fn() -> bool) -> Result<(), PointsError> {
    if goes_on() { Ok(()) } else { Err(PointsError::Stopped) }
}

/// The usable points, packed.
struct KMeansPoints {
    dimensions: usize,
    points: Vec<f32>,
    weights: Vec<f32>,
    rows: Vec<u32>,
}

/// The result of one seeding: centroids, labels from 0, cluster weights.
#[derive(Default)]
struct KMeansFit {
    centroids: Vec<f32>,
    labels: Vec<u32>,
    weights: Vec<f64>,
    distortion: f64,
}

/// The sums of one pass over the points.
struct Pass {
    sums: Vec<f64>,
    weights: Vec<f64>,
    distortion: f64,
    changed: bool,
    farthest: (f64, usize),
}

impl KMeansPoints {
    fn gather(points: &[f32], dimensions: usize, weights: &[f32]) -> Self {
        let mut data = Self { dimensions, points: Vec::new(), weights: Vec::new(), rows: Vec::new() };
        for (i, row) in points.chunks_exact(dimensions).enumerate() {
            if row.iter().all(|v| v.is_finite()) {
                let weight = weights.get(i).copied().unwrap_or(1.0);
                data.points.extend_from_slice(row);
                data.weights.push(if weight.is_finite() { weight.max(0.0) } else { 0.0 });
                data.rows.push(i as u32);
            }
        }
        if data.weights.iter().all(|&w| w == 0.0) {
            data.weights.fill(1.0);
        }
        data
    }

    fn row(&self, i: usize) -> &[f32] {
        &self.points[i * self.dimensions..(i + 1) * self.dimensions]
    }

    fn fit(
        &self,
        config: &KMeansConfig,
        uniform: &mut impl FnMut() -> f32,
        goes_on: &dyn Fn() -> bool,
    ) -> Result<KMeansFit, PointsError> {
        let mut centroids = self.seed(config.clusters, uniform, goes_on)?;
        let mut labels = vec![u32::MAX; self.rows.len()];
        let mut before = f64::INFINITY;
        for _ in 0..config.max_iterations {
            check(goes_on)?;
            let pass = self.pass(&centroids, &mut labels);
            self.mean(&pass, &mut centroids);
            let reseeded = match pass.weights.iter().position(|&w| w == 0.0) {
                Some(empty) if pass.farthest.0 > 0.0 => {
                    let d = self.dimensions;
                    centroids[empty * d..(empty + 1) * d].copy_from_slice(self.row(pass.farthest.1));
                    true
                }
                _ => false,
            };
            let gain = before - pass.distortion;
            if !reseeded && (!pass.changed || gain <= config.tolerance * pass.distortion) {
                break;
            }
            before = pass.distortion;
        }
        let pass = self.pass(&centroids, &mut labels);
        Ok(KMeansFit { centroids, labels, weights: pass.weights, distortion: pass.distortion })
    }

    /// k-means++ seeding; returns fewer centroids where the points hold fewer distinct positions.
    fn seed(
        &self,
        clusters: usize,
        uniform: &mut impl FnMut() -> f32,
        goes_on: &dyn Fn() -> bool,
    ) -> Result<Vec<f32>, PointsError> {
        let mut costs: Vec<f64> = self.weights.iter().map(|&w| f64::from(w)).collect();
        let mut nearest = vec![f64::INFINITY; self.rows.len()];
        // no more centroids can be found than there are points
        let mut centroids: Vec<f32> = Vec::with_capacity(clusters.min(self.rows.len()) * self.dimensions);
        for _ in 0..clusters {
            check(goes_on)?;
            let Some(chosen) = draw(&costs, fine_uniform(uniform)) else { break };
            let centre = self.row(chosen).to_vec();
            centroids.extend_from_slice(&centre);
            costs.par_chunks_mut(CHUNK).zip(nearest.par_chunks_mut(CHUNK)).enumerate().for_each(
                |(c, (costs, near))| {
                    for (j, (cost, near)) in costs.iter_mut().zip(near).enumerate() {
                        let i = c * CHUNK + j;
                        *near = near.min(f64::from(squared(self.row(i), &centre)));
                        *cost = f64::from(self.weights[i]) * *near;
                    }
                },
            );
        }
        Ok(centroids)
    }

    fn pass(&self, centroids: &[f32], labels: &mut [u32]) -> Pass {
        let (d, k) = (self.dimensions, centroids.len() / self.dimensions);
        let parts: Vec<Pass> = labels
            .par_chunks_mut(CHUNK)
            .enumerate()
            .map(|(c, labels)| {
                let mut part = Pass::new(d, k);
                for (j, label) in labels.iter_mut().enumerate() {
                    let (i, row) = (c * CHUNK + j, self.row(c * CHUNK + j));
                    let (nearest, distance) = nearest(row, centroids, d);
                    let weight = f64::from(self.weights[i]);
                    part.changed |= *label != nearest as u32;
                    *label = nearest as u32;
                    part.weights[nearest] += weight;
                    for (sum, v) in part.sums[nearest * d..(nearest + 1) * d].iter_mut().zip(row) {
                        *sum += weight * f64::from(*v);
                    }
                    let cost = weight * f64::from(distance);
                    part.distortion += cost;
                    if cost > part.farthest.0 {
                        part.farthest = (cost, i);
                    }
                }
                part
            })
            .collect();
        let mut total = Pass::new(d, k);
        for part in parts {
            total.sums.iter_mut().zip(&part.sums).for_each(|(a, b)| *a += b);
            total.weights.iter_mut().zip(&part.weights).for_each(|(a, b)| *a += b);
            total.distortion += part.distortion;
            total.changed |= part.changed;
            if part.farthest.0 > total.farthest.0 {
                total.farthest = part.farthest;
            }
        }
        total
    }

    fn mean(&self, pass: &Pass, centroids: &mut [f32]) {
        for (k, &weight) in pass.weights.iter().enumerate().filter(|(_, w)| **w > 0.0) {
            for c in k * self.dimensions..(k + 1) * self.dimensions {
                centroids[c] = (pass.sums[c] / weight) as f32;
            }
        }
    }

    /// Drops empty clusters and sorts the rest by weight.
    fn finish(&self, fit: KMeansFit, count: usize) -> KMeans {
        let d = self.dimensions;
        let mut order: Vec<usize> = (0..fit.weights.len()).filter(|&k| fit.weights[k] > 0.0).collect();
        let centre = |k: usize| &fit.centroids[k * d..(k + 1) * d];
        order.sort_by(|&a, &b| {
            let by_place = || centre(a).partial_cmp(centre(b)).unwrap_or(std::cmp::Ordering::Equal);
            fit.weights[b].total_cmp(&fit.weights[a]).then_with(by_place)
        });
        let centroids: Vec<f32> = order.iter().flat_map(|&k| centre(k).to_vec()).collect();
        let mut new_label = vec![0u32; fit.weights.len()];
        for (rank, &old) in order.iter().enumerate() {
            new_label[old] = rank as u32 + 1;
        }
        let mut labels = vec![0u32; count];
        for (i, (&row, &old)) in self.rows.iter().zip(&fit.labels).enumerate() {
            let label = new_label[old as usize];
            // a point without weight may sit in a dropped cluster
            labels[row as usize] = if label > 0 { label } else { nearest(self.row(i), &centroids, d).0 as u32 + 1 };
        }
        let weights = order.iter().map(|&k| fit.weights[k]).collect();
        KMeans { dimensions: d, centroids, labels, weights, distortion: fit.distortion }
    }
}

impl Pass {
    fn new(d: usize, k: usize) -> Self {
        Self { sums: vec![0.0; k * d], weights: vec![0.0; k], distortion: 0.0, changed: false, farthest: (0.0, 0) }
    }
}

/// Returns the index at which the running sum of `costs` passes the fraction `share` of the total; `None` if the total
/// is 0.
fn draw(costs: &[f64], share: f64) -> Option<usize> {
    let total: f64 = costs.iter().sum();
    if total <= 0.0 {
        return None;
    }
    let (mut left, mut last) = (share * total, None);
    for (i, &cost) in costs.iter().enumerate().filter(|(_, c)| **c > 0.0) {
        last = Some(i);
        left -= cost;
        if left < 0.0 {
            break;
        }
    }
    last
}

/// Returns the row of the nearest centroid and its squared distance; the first among equals.
pub fn nearest(row: &[f32], centroids: &[f32], dimensions: usize) -> (usize, f32) {
    let mut best = (0, f32::INFINITY);
    for (k, centre) in centroids.chunks_exact(dimensions).enumerate() {
        let distance = squared(row, centre);
        if distance < best.1 {
            best = (k, distance);
        }
    }
    best
}

pub(crate) fn squared(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum()
}

#[cfg(test)]
#[path = "kmeans_tests.rs"]
pub(crate) mod tests;
