//! Separates touching objects of one colour, which form a single piece in space, by their affinity.
//!
//! Masks separate touching objects where an edge is visible between them, so that whole objects have dissimilar
//! features at the largest mask scale. But the features of one large object drift, too, as its sides are never seen
//! together. Two objects are separated where few Gaussians touch and the feature changes abruptly: patches of similar
//! features are joined ([`regions`]) until both separate the remaining ones.

use super::contacts::Neighbourhood;
use crate::config::types::SegmentConfig;
use crate::config::types::segment::ObjectsConfig;
use crate::model::HostGaussians;
use crate::points::PointsError;
use crate::points::components::largest_scales;
use crate::points::regions::{self, WeightedEdge};
use crate::points::union_find::UnionFind;
use kodama::{Method, linkage};
use rayon::prelude::*;
use std::collections::BTreeMap;
use volseggs_kernels::contrast::FEATURES;

/// Returns the object of each Gaussian of `body`, a single connected piece, `[M]` from 1, the largest first; all 1
/// where the affinity finds only one. `features` are those of the affinity field at `segment.objects.scale`,
/// `[M, 16]`, of unit length.
///
/// # Errors
/// If the arrays of `body` disagree.
///
/// # Panics
/// If `features` does not hold one feature per Gaussian.
pub fn objects(body: &HostGaussians, features: &[f32], config: &SegmentConfig) -> Result<Vec<u32>, PointsError> {
    assert_eq!(features.len(), FEATURES * body.len(), "features: [M, 16]");
    let (reach, config) = (config.pieces.reach, &config.objects);
    let groups = if config.separate { groups(features, config) } else { Vec::new() };
    if groups.len() < 2 {
        return Ok(vec![1; body.len()]);
    }
    let group: Vec<u32> = features.par_chunks_exact(FEATURES).map(|row| most_like(row, &groups)).collect();
    let touching = touching(body, config.neighbours, reach)?;
    let of = UnionFind::new(body.len());
    touching.iter().filter(|(a, b)| group[*a as usize] == group[*b as usize]).for_each(|&(a, b)| of.union(a, b));
    let patches: Vec<u32> = (0..body.len() as u32).map(|i| of.find(i)).collect();
    let tiny = (config.tiny * body.len() as f64).ceil() as usize;
    Ok(regions::join(&patches, &weighted(features, &touching), tiny, config.narrow))
}

fn row(features: &[f32], i: usize) -> &[f32] {
    &features[FEATURES * i..FEATURES * (i + 1)]
}

fn cosine(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// 1 - the cosine of two features; 2 if one is not finite, so that it is similar to none.
fn distance(a: &[f32], b: &[f32]) -> f32 {
    match 1.0 - cosine(a, b) {
        // only if finite: the maximum of NaN and 0 is 0
        distance if distance.is_finite() => distance.max(0.0),
        _ => 2.0,
    }
}

/// Mean directions `[G][16]` of the groups of similar features, by average linkage of a sample.
fn groups(features: &[f32], config: &ObjectsConfig) -> Vec<[f32; FEATURES]> {
    let count = features.len() / FEATURES;
    let n = count.min(config.sample);
    let sample: Vec<&[f32]> = (0..n).map(|k| row(features, k * count / n)).collect();
    let mut sums: BTreeMap<u32, [f32; FEATURES]> = BTreeMap::new();
    for (feature, group) in sample.iter().zip(grouped(&sample, config.alike)) {
        sums.entry(group).or_insert([0.0; FEATURES]).iter_mut().zip(*feature).for_each(|(sum, v)| *sum += v);
    }
    let direction = |sum: [f32; FEATURES]| {
        let length = cosine(&sum, &sum).sqrt().max(f32::MIN_POSITIVE);
        sum.map(|v| v / length)
    };
    sums.into_values().map(direction).collect()
}

/// A number for each feature, the same for those of one group, whose mean cosine is at least `alike`.
fn grouped(sample: &[&[f32]], alike: f32) -> Vec<u32> {
    let n = sample.len();
    let of = UnionFind::new(n);
    if n > 1 {
        let later = |(k, a): (usize, &&[f32])| sample[k + 1..].iter().map(|b| distance(a, b)).collect::<Vec<f32>>();
        let mut distances: Vec<f32> = sample.iter().enumerate().flat_map(later).collect();
        // one observation of each cluster: first the single observations, then the clusters that the steps form
        let mut any: Vec<u32> = (0..n as u32).collect();
        for step in linkage(&mut distances, n, Method::Average).steps() {
            let (a, b) = (any[step.cluster1], any[step.cluster2]);
            any.push(a);
            if step.dissimilarity <= 1.0 - alike {
                of.union(a, b);
            }
        }
    }
    (0..n as u32).map(|k| of.find(k)).collect()
}

fn most_like(feature: &[f32], groups: &[[f32; FEATURES]]) -> u32 {
    let mut best = (0, f32::NEG_INFINITY);
    for (n, group) in (0..).zip(groups) {
        let cosine = cosine(feature, group);
        if cosine > best.1 {
            best = (n, cosine);
        }
    }
    best.0
}

/// The pairs of touching Gaussians, among each one and its `neighbours` nearest, as far as `reach`.
fn touching(body: &HostGaussians, neighbours: usize, reach: f32) -> Result<Vec<(u32, u32)>, PointsError> {
    let all = Neighbourhood::new(body.means.clone(), largest_scales(&body.log_scales)?)?;
    let of = |i: usize| {
        let touch = all.within(i, neighbours, reach);
        touch.map(|j| (i as u32, j as u32)).collect::<Vec<_>>()
    };
    Ok((0..body.len()).into_par_iter().map(of).collect::<Vec<_>>().concat())
}

/// The same pairs with weights: the more the feature changes, relative to the median change, the lower the weight.
fn weighted(features: &[f32], touching: &[(u32, u32)]) -> Vec<WeightedEdge> {
    let change = |&(a, b): &(u32, u32)| f64::from(distance(row(features, a as usize), row(features, b as usize)));
    let changes: Vec<f64> = touching.par_iter().map(change).collect();
    let mut sorted = changes.clone();
    let middle = sorted.len() / 2;
    let usual = if sorted.is_empty() { 1.0 } else { *sorted.select_nth_unstable_by(middle, f64::total_cmp).1 };
    let weight = |change: f64| (-change / (2.0 * usual.max(1e-9))).exp();
    touching.iter().zip(changes).map(|(&(a, b), change)| (a, b, weight(change))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::test_support::{on_threads, surfaces};

    fn found(body: &HostGaussians, features: &[f32]) -> Result<Vec<u32>, PointsError> {
        objects(body, features, &SegmentConfig::default())
    }

    /// A unit feature at `angle`, radians, in the plane of the first two axes.
    fn at(angle: f32) -> [f32; FEATURES] {
        let mut feature = [0.0; FEATURES];
        (feature[0], feature[1]) = (angle.cos(), angle.sin());
        feature
    }

    fn counts(labels: &[u32]) -> Vec<usize> {
        let most = labels.iter().max().copied().unwrap_or(0);
        (1..=most).map(|label| labels.iter().filter(|l| **l == label).count()).collect()
    }

    #[test]
    fn touching_balls_are_two_objects_only_where_their_features_differ() {
        let (body, of) = surfaces(&[(-0.97, 1.0), (0.97, 1.0)]);
        let unlike: Vec<f32> = of.iter().flat_map(|ball| at(0.9 * *ball as f32)).collect();
        let parts = found(&body, &unlike).unwrap();
        assert_eq!(counts(&parts).len(), 2);
        let wrong = parts.iter().zip(&of).filter(|(label, ball)| (parts[0] == **label) != (of[0] == **ball)).count();
        assert!(wrong * 50 < of.len(), "{wrong} of {}", of.len());
        assert_eq!(parts, on_threads(1, || found(&body, &unlike)).unwrap());
        let like: Vec<f32> = of.iter().flat_map(|ball| at(0.3 * *ball as f32)).collect();
        assert_eq!(found(&body, &like).unwrap(), vec![1; body.len()]);
    }

    #[test]
    fn one_ball_stays_one_though_its_features_drift_from_side_to_side() {
        let (body, _) = surfaces(&[(0.0, 1.0)]);
        // by more than two radians in all: opposite sides are unlike
        let drift: Vec<f32> = body.means.chunks_exact(3).flat_map(|p| at(1.2 * p[0])).collect();
        assert!(groups(&drift, &ObjectsConfig::default()).len() > 2, "there are several patches of similar features");
        assert_eq!(found(&body, &drift).unwrap(), vec![1; body.len()]);
    }

    #[test]
    fn features_that_are_not_finite_are_similar_to_none_and_join_no_others() {
        let features = [at(0.0), at(0.0), at(f32::NAN), at(f32::NAN), at(1.2), at(1.2)];
        let sample: Vec<&[f32]> = features.iter().map(|feature| &feature[..]).collect();
        let found = grouped(&sample, ObjectsConfig::default().alike);
        assert!(found[0] == found[1] && found[4] == found[5], "{found:?}");
        let apart = [found[0], found[2], found[3], found[4]];
        assert!((1..4).all(|k| !apart[..k].contains(&apart[k])), "{found:?}");
        // nor does a contact with one of them hold an object together
        let weights = weighted(&features.concat(), &[(0, 1), (4, 5), (1, 4), (1, 2), (2, 3)]).into_iter().map(|e| e.2);
        let [alike, too, unlike, not_finite, neither] = weights.collect::<Vec<f64>>()[..] else { unreachable!() };
        assert!(alike == 1.0 && too == 1.0 && not_finite < unlike && neither < unlike && unlike < 1.0);
    }

    #[test]
    fn empty_single_and_non_finite_inputs() {
        let (body, of) = surfaces(&[(-0.97, 1.0), (0.97, 1.0)]);
        assert_eq!(found(&body.subset(&[]), &[]).unwrap(), [0u32; 0]);
        assert_eq!(found(&body.subset(&[4]), &at(0.1)).unwrap(), [1]);
        let mut features: Vec<f32> = of.iter().flat_map(|ball| at(0.9 * *ball as f32)).collect();
        features[..FEATURES].fill(f32::NAN);
        let mut poisoned = body.clone();
        (poisoned.means[30], poisoned.log_scales[60]) = (f32::NAN, f32::INFINITY);
        let found = found(&poisoned, &features).unwrap();
        assert!(found.len() == body.len() && found.iter().all(|label| *label > 0));
    }
}
