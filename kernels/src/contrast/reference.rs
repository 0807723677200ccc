//! The loss as plain f64 loops over all pairs: the oracle of the fast loops.

use super::{FEATURES, Repulsion};

/// Returns the mean loss over all pairs of `features` `[P, 16]`, where pixel `i` belongs to the mask `masks[i]`. A
/// feature of norm 0 has cosine 0 with every feature.
pub fn contrast(features: &[f64], masks: &[u32], repulsion: Repulsion) -> f64 {
    let row = |i: usize| &features[i * FEATURES..][..FEATURES];
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let n = masks.len();
    let mut sum = 0.0;
    for i in 0..n {
        for j in 0..n {
            let (a, b) = (row(i), row(j));
            let lengths = (dot(a, a) * dot(b, b)).sqrt();
            let cosine = if lengths == 0.0 { 0.0 } else { dot(a, b) / lengths };
            sum += match repulsion {
                _ if masks[i] == masks[j] => 1.0 - cosine,
                Repulsion::Cosine => cosine,
                Repulsion::None => 0.0,
                Repulsion::Margin(m) => (cosine - f64::from(m)).max(0.0),
            };
        }
    }
    sum / (n * n) as f64
}
