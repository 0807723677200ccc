//! The trained model: smoothed features and the gate, and what a click selects with them.

use super::loss::{FEATURES, Feature, ScaleGate, dot, unit};
use super::smooth::{directions, means_of, with_neighbours};
use crate::points::nearest_rows::NearestRows;
use rayon::prelude::*;

/// Trained features of N Gaussians, smoothed once, so that a click costs one dot product per Gaussian.
#[derive(Clone, Debug, PartialEq)]
pub struct SagaModel {
    /// Unit features, smoothed over all neighbours, `[N]`.
    features: Vec<Feature>,
    gate: ScaleGate,
    /// Whether each Gaussian has a finite position, `[N]`.
    placed: Vec<bool>,
}

impl SagaModel {
    /// Builds the model from unit features `[N, 32]` before smoothing and the `neighbours` `[N, per - 1]` to average over.
    pub(super) fn new(own: &[f32], (neighbours, per): (&NearestRows, usize), gate: ScaleGate, means: &[f32]) -> Self {
        let near = (0..means.len() as u32 / 3).flat_map(|i| with_neighbours(neighbours, i)).collect();
        let smooth = means_of(near, per).gather(own, FEATURES);
        let features = directions(&smooth).into_iter().map(|row| row.0).collect();
        let placed = means.chunks_exact(3).map(|m| m.iter().all(|v| v.is_finite())).collect();
        Self { features, gate, placed }
    }

    /// Number of Gaussians, N.
    pub fn len(&self) -> usize {
        self.features.len()
    }

    /// True if there are no Gaussians.
    pub fn is_empty(&self) -> bool {
        self.features.is_empty()
    }

    /// Returns the similarity of each Gaussian to number `clicked` at `scale` in [0, 1], from 0 to 1, `[N]`:
    /// `(cosine + 1) / 2` of the gated features. NaN for Gaussians without a finite position, and for all if `clicked`
    /// has none.
    ///
    /// # Panics
    /// If `clicked` is not below N.
    pub fn similarity(&self, clicked: u32, scale: f32) -> Vec<f32> {
        let gate = self.gate.at(scale);
        let gated = |f: &Feature| unit(std::array::from_fn(|k| f[k] * gate[k])).0;
        let of = gated(&self.features[clicked as usize]);
        let clicked = self.placed[clicked as usize];
        let rows = self.features.par_iter().zip(&self.placed);
        rows.map(|(f, &placed)| if placed && clicked { 0.5 * (dot(&gated(f), &of) + 1.0) } else { f32::NAN }).collect()
    }

    /// Returns which Gaussians have a similarity to number `clicked` above `threshold`, at `scale` in [0, 1] from small
    /// parts to large ones, `[N]`. Gaussians without a finite position never do.
    ///
    /// # Panics
    /// If `clicked` is not below N.
    pub fn select(&self, clicked: u32, scale: f32, threshold: f32) -> Vec<bool> {
        self.similarity(clicked, scale).into_iter().map(|s| s > threshold).collect()
    }
}
