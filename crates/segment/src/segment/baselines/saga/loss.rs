//! The contrastive loss over pairs of pixels at several scales, with its gradient, and the scale gate. Nothing here
//! depends on which Gaussians contribute to a pixel.

use crate::segment::fine::views::FineView;
use rayon::prelude::*;
use std::collections::HashMap;
use volseggs_kernels::activation::sigmoid;

/// Length of a feature.
pub(super) const FEATURES: usize = 32;
/// A feature.
pub(super) type Feature = [f32; FEATURES];
/// Weight of the pair with the smallest masks; that with the largest has 1.
const MAX_PAIR_WEIGHT: f32 = 10.0;
/// Pixels per parallel task; a constant, so that sums do not depend on the number of threads.
const ROWS: usize = 32;
/// Features shorter than this have no direction.
const MIN_LENGTH: f32 = 1e-12;

/// The scale gate: a factor for each channel that depends on the scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ScaleGate {
    pub(super) weight: Feature,
    pub(super) bias: Feature,
}

impl ScaleGate {
    const ZERO: Self = Self { weight: [0.0; FEATURES], bias: [0.0; FEATURES] };

    /// Returns the factors, in (0, 1), at `scale`.
    pub(super) fn at(&self, scale: f32) -> Feature {
        std::array::from_fn(|k| sigmoid(self.weight[k] * scale + self.bias[k]))
    }
}

/// Properties of a view's masks that do not change from step to step.
#[derive(Clone, Debug)]
pub(super) struct Facts {
    /// For each mask, how many of the view's pixels it covers.
    sizes: Vec<u32>,
    /// For each mask, its rank from small to large.
    order: Vec<u32>,
    /// Scales of masks that cover anything, ascending, each once.
    pub(super) scales: Vec<f32>,
}

impl Facts {
    pub(super) fn of(view: &FineView) -> Self {
        let mut sizes = vec![0u32; view.scales.len()];
        view.covering.iter().for_each(|&m| sizes[m as usize] += 1);
        let mut sorted: Vec<usize> = (0..sizes.len()).collect();
        sorted.sort_by(|&a, &b| view.scales[a].total_cmp(&view.scales[b]).then(a.cmp(&b)));
        let mut order = vec![0; sizes.len()];
        sorted.iter().zip(0..).for_each(|(&m, place)| order[m] = place);
        let mut scales: Vec<f32> = sorted.iter().filter(|&&m| sizes[m] > 0).map(|&m| view.scales[m]).collect();
        scales.dedup();
        Self { sizes, order, scales }
    }

    /// Returns the scale above which two pixels with the mask lists `a` and `b` share a mask.
    ///
    /// At a scale, a pixel uses its masks below that scale and the next larger one. So a shared mask counts above the
    /// scales of the masks just before it in both lists, and the smallest shared one decides.
    pub(super) fn joined(&self, view: &FineView, a: &[u32], b: &[u32]) -> f32 {
        let before =
            |list: &[u32], at: usize| at.checked_sub(1).map_or(f32::NEG_INFINITY, |k| view.scales[list[k] as usize]);
        let (mut i, mut j) = (0, 0);
        while i < a.len() && j < b.len() {
            let [x, y] = [a[i], b[j]].map(|m| self.order[m as usize]);
            if x == y {
                return before(a, i).max(before(b, j));
            }
            (i, j) = (i + usize::from(x < y), j + usize::from(y < x));
        }
        f32::INFINITY
    }
}

/// Which of P pixels belong together at which scale, and how much each pair counts.
#[derive(Clone, Debug)]
pub(super) struct PixelPairs {
    /// Index of each pixel's list of masks among the L distinct ones, `[P]`.
    lists: Vec<u32>,
    /// The scale above which two lists share a mask, `[L, L]`.
    joined: Vec<f32>,
    /// One over the mean size of a pixel's masks, `[P]`.
    inverse: Vec<f32>,
}

impl PixelPairs {
    /// Collects the data of the pixels `chosen` of `view`.
    pub(super) fn new(view: &FineView, facts: &Facts, chosen: &[usize]) -> Self {
        let mut numbers: HashMap<&[u32], u32> = HashMap::new();
        let mut distinct = Vec::new();
        let lists: Vec<u32> = chosen
            .iter()
            .map(|&p| {
                let list = view.covering(p);
                *numbers.entry(list).or_insert_with(|| {
                    distinct.push(list);
                    distinct.len() as u32 - 1
                })
            })
            .collect();
        let joined = distinct.par_iter().flat_map_iter(|a| distinct.iter().map(|b| facts.joined(view, a, b))).collect();
        let inverse = chosen.iter().map(|&p| {
            let list = view.covering(p);
            let total: f32 = list.iter().map(|&m| facts.sizes[m as usize] as f32).sum();
            list.len() as f32 / total.max(1.0)
        });
        Self { lists, joined, inverse: inverse.collect() }
    }

    /// Number of pixels.
    pub(super) fn len(&self) -> usize {
        self.lists.len()
    }

    /// Returns `(constant, factor)`: a pair's weight is the constant plus the factor times the product of its
    /// `inverse`.
    fn weighing(&self) -> (f32, f32) {
        let low = self.inverse.iter().copied().fold(f32::INFINITY, f32::min).powi(2);
        let high = self.inverse.iter().copied().fold(0.0, f32::max).powi(2);
        if high <= low {
            return (1.0, 0.0);
        }
        let factor = (MAX_PAIR_WEIGHT - 1.0) / (high - low);
        (1.0 - factor * low, factor)
    }
}

/// Which pairs count.
#[derive(Clone, Copy, Debug)]
pub(super) struct PairRule {
    /// Pairs that should be similar are hard below this cosine.
    pub(super) alike: f32,
    /// Pairs that should differ are hard above this cosine.
    pub(super) apart: f32,
    /// Which of the [`Self::TURNS`] subsets of the easy pairs counts.
    pub(super) turn: usize,
}

impl PairRule {
    /// Of the pairs that are easy and the same at all scales, one in this many counts.
    pub(super) const TURNS: usize = 8;
}

/// The loss and its gradient.
#[derive(Clone, Debug)]
pub(super) struct Loss {
    pub(super) loss: f64,
    /// With respect to the given features, `[P, 32]`.
    pub(super) features: Vec<f32>,
    pub(super) gate: ScaleGate,
}

/// Computes the loss of the rendered `features` `[P, 32]`: the mean over all pairs at all `scales` (ascending), plus
/// the mean of `(1 - |F|)^2` over the pixels. Features shorter than [`MIN_LENGTH`] count as 0 and get no gradient.
pub(super) fn contrast(
    features: &[f32],
    pixels: &PixelPairs,
    scales: &[f32],
    gate: &ScaleGate,
    rule: PairRule,
) -> Loss {
    let (p, s) = (pixels.len(), scales.len());
    let gates: Vec<Feature> = scales.iter().map(|&scale| gate.at(scale)).collect();
    let rendered: Vec<Feature> = features.chunks_exact(FEATURES).map(|f| std::array::from_fn(|k| f[k])).collect();
    // gated features, normalised, and their original lengths, `[S, P]`
    let gated: Vec<(Feature, f32)> = gates
        .par_iter()
        .flat_map_iter(|g| rendered.iter().map(|f| unit(std::array::from_fn(|k| f[k] * g[k]))))
        .collect();
    let units: Vec<Feature> = gated.iter().map(|u| u.0).collect();
    let pairs = (s * p * p.saturating_sub(1)).max(1) as f32;
    let (constant, factor) = pixels.weighing();
    let kinds = (pixels.joined.len() as f64).sqrt() as usize;
    let (first, last) = (scales.first().copied().unwrap_or(0.0), scales.last().copied().unwrap_or(0.0));
    let starts: Vec<usize> = (0..p).step_by(ROWS).collect();
    let parts: Vec<(f64, Vec<Feature>, Vec<Feature>)> = starts
        .into_par_iter()
        .map(|start| {
            let (mut loss, mut by_feature, mut by_gate) = (0.0f64, Vec::with_capacity(ROWS), vec![[0.0; FEATURES]; s]);
            for i in start..p.min(start + ROWS) {
                let joined = &pixels.joined[pixels.lists[i] as usize * kinds..][..kinds];
                let mut slope = [0.0f32; FEATURES];
                for (k, &scale) in scales.iter().enumerate() {
                    let row = &units[k * p..][..p];
                    let mut by_unit = [0.0f32; FEATURES];
                    for (j, other) in row.iter().enumerate() {
                        let from = joined[pixels.lists[j] as usize];
                        let cosine = dot(&row[i], other);
                        let alike = scale > from;
                        let hard = if alike { cosine < rule.alike } else { cosine > rule.apart };
                        let changes = first <= from && from < last;
                        let counts = hard || changes || (i + j) % PairRule::TURNS == rule.turn;
                        if i == j || !counts || !(alike || cosine > 0.0) {
                            continue;
                        }
                        let weight = constant + factor * pixels.inverse[i] * pixels.inverse[j];
                        let weight = if alike { -weight } else { weight };
                        loss += f64::from(weight * cosine);
                        by_unit.iter_mut().zip(other).for_each(|(b, o)| *b += weight * o);
                    }
                    // each pair is visited from both of its pixels
                    by_unit.iter_mut().for_each(|b| *b *= 2.0 / pairs);
                    let by_gated = through_unit(&by_unit, &gated[k * p + i]);
                    for c in 0..FEATURES {
                        slope[c] += by_gated[c] * gates[k][c];
                        by_gate[k][c] += by_gated[c] * rendered[i][c];
                    }
                }
                by_feature.push(slope);
            }
            (loss / f64::from(pairs), by_feature, by_gate)
        })
        .collect();
    let mut out = Loss { loss: 0.0, features: Vec::with_capacity(features.len()), gate: ScaleGate::ZERO };
    for (loss, by_feature, by_gate) in parts {
        out.loss += loss;
        out.features.extend(by_feature.iter().flatten());
        for ((slope, gate), &scale) in by_gate.iter().zip(&gates).zip(scales) {
            for c in 0..FEATURES {
                let inner = slope[c] * gate[c] * (1.0 - gate[c]);
                out.gate.weight[c] += inner * scale;
                out.gate.bias[c] += inner;
            }
        }
    }
    for (slope, f) in out.features.chunks_exact_mut(FEATURES).zip(&rendered) {
        let (direction, length) = unit(*f);
        out.loss += f64::from((1.0 - length).powi(2)) / p as f64;
        slope.iter_mut().zip(&direction).for_each(|(s, d)| *s -= 2.0 * (1.0 - length) / p as f32 * d);
    }
    out
}

/// Returns the direction of `v`, or zeros if it is too short, and its length.
pub(super) fn unit(v: Feature) -> (Feature, f32) {
    let length = dot(&v, &v).sqrt();
    if length <= MIN_LENGTH { ([0.0; FEATURES], length) } else { (v.map(|x| x / length), length) }
}

/// Returns the gradient with respect to a vector from that with respect to its direction, without the component along
/// it.
pub(super) fn through_unit(slope: &Feature, (direction, length): &(Feature, f32)) -> Feature {
    if *length <= MIN_LENGTH {
        return [0.0; FEATURES];
    }
    let along = dot(slope, direction);
    std::array::from_fn(|k| (slope[k] - along * direction[k]) / length)
}

/// Computes the dot product in eight independent sums, to fill vector registers.
#[inline(always)]
pub(super) fn dot(a: &Feature, b: &Feature) -> f32 {
    let mut sums = [0.0f32; 8];
    for (a, b) in a.chunks_exact(8).zip(b.chunks_exact(8)) {
        for lane in 0..8 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    let [a, b, c, d, e, f, g, h] = sums;
    ((a + e) + (b + f)) + ((c + g) + (d + h))
}
