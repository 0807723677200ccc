//! The contrastive loss over unit features (the paper's equations 10 and 11), with its gradient: pairs of pixels of one
//! mask attract, all others repel. Fast loops in `cpu`, oracle in [`mod@reference`].
//!
//! Not a backend op: it runs on the host only, for `segment::fine`. It is in this crate because its loops use vector
//! instructions, which only this crate does, and only this crate is optimised in test builds.
//!
//! Without a margin, the sum over all pairs needs no loop over pairs: with unit features `u`, their sums `S_m` over
//! each mask and `S` over all, it is `sum_m (n_m^2 - |S_m|^2) + |S|^2 - sum_m |S_m|^2`.

mod cpu;
pub mod reference;
#[cfg(test)]
mod tests;

/// Length of a feature.
pub const FEATURES: usize = 16;

/// Loss and its gradient with respect to the features `[P, 16]`, both averaged over all P^2 pairs.
#[derive(Clone, Debug, PartialEq)]
pub struct Contrast {
    /// The mean loss.
    pub loss: f64,
    /// Its gradient with respect to the features as given, before normalisation.
    pub gradient: Vec<f32>,
}

/// How pixels of different masks repel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Repulsion {
    /// By their cosine, as in the paper.
    Cosine,
    /// By the excess of the cosine over this margin, as in the reference code (0.5 there).
    Margin(f32),
    /// Not at all: only the attraction within masks counts.
    None,
}

/// Computes the loss of `features` `[P, 16]`, where pixel `i` belongs to the mask `masks[i]`. Features of norm 0 count
/// as 0 and get no gradient; NaN is propagated, for the caller to detect.
///
/// # Panics
/// If the lengths disagree.
pub fn contrast(features: &[f32], masks: &[u32], repulsion: Repulsion) -> Contrast {
    assert_eq!(features.len(), masks.len() * FEATURES, "features: [P, {FEATURES}]");
    let norms: Vec<f32> =
        features.chunks_exact(FEATURES).map(|f| f.iter().map(|v| v * v).sum::<f32>().sqrt()).collect();
    let units: Vec<f32> = features
        .chunks_exact(FEATURES)
        .zip(&norms)
        .flat_map(|(f, n)| f.iter().map(move |v| if *n <= 1e-12 { 0.0 } else { v / n }))
        .collect();
    let (loss, by_unit) = match repulsion {
        Repulsion::Cosine => cpu::by_sums(&units, masks, true),
        Repulsion::None => cpu::by_sums(&units, masks, false),
        Repulsion::Margin(margin) => cpu::by_pairs(&units, masks, margin),
    };
    // back through the normalisation: the component along the feature drops out
    let rows = by_unit.chunks_exact(FEATURES).zip(units.chunks_exact(FEATURES)).zip(&norms);
    let gradient = rows
        .flat_map(|((g, u), &norm)| {
            let along: f32 = g.iter().zip(u).map(|(g, u)| g * u).sum();
            (0..FEATURES).map(move |k| if norm <= 1e-12 { 0.0 } else { (g[k] - along * u[k]) / norm })
        })
        .collect();
    Contrast { loss, gradient }
}
