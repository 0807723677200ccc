//! Relocation (Kheradmand et al., "3D Gaussian Splatting as Markov Chain Monte Carlo", 2024): instead of being removed,
//! transparent Gaussians move to the positions of opaque ones.
//!
//! The noise that the publication adds to the means of transparent Gaussians at every step is not offered: here a Gaussian
//! may be transparent at one time and opaque at another. In its place a Gaussian and its copies are moved [`APART`], once:
//! coinciding ones get nearly the same gradients, and most would never separate.

use super::{Candidates, DensificationRule, RowSource};
use crate::config::types::Config;
use crate::model::HostGaussians;
use crate::rng::{Purpose, Rng};
use std::collections::BTreeMap;
use volseggs_kernels::activation::{logit_f64, sigmoid_f64};

/// Standard deviation of the random offset of each share, as a fraction of its own. Over none, 0.3 wins 0.15 to 0.3 dB with
/// each of three seeds, and 1 nothing: see the results of 2026-11-27 in `benches/results`.
pub(super) const APART: f32 = 0.3;
/// Maximum number of shares for which opacity and size of each are computed; more shares get those for this number.
const MAX_SHARES: usize = 51;
/// Shared opacities are clamped to this distance from 0 and 1, so that their logits are finite.
const LIMIT: f64 = 1e-7;

/// As many as in `budget` mode, and one for each that is removed, copied from Gaussians drawn in proportion to their
/// opacity. A Gaussian and its copies share its opacity, so that the image stays the same.
pub(super) struct Relocate;

impl DensificationRule for Relocate {
    fn plan(&self, seen: &Candidates<'_>) -> Vec<RowSource> {
        let wanted = seen.target.unwrap_or(0).max(seen.count) - seen.alive.len();
        let mut rng = Rng::new(seen.config.seed, seen.step as u64, Purpose::Relocation);
        plan(seen.alive, |i| seen.opacities[i], wanted, &mut rng)
    }

    fn max_gaussians(&self, config: &Config) -> u128 {
        // one Gaussian may have many copies
        config.densify.max_budget().max(config.init.points as u128)
    }

    fn shares_opacity(&self) -> bool {
        true
    }
}

/// Plans the rows of the new arrays: those of `alive`, and `wanted` copies of them, drawn with replacement in proportion to
/// `opacity`. Nothing is copied if all are transparent.
fn plan(alive: &[usize], opacity: impl Fn(usize) -> f32, wanted: usize, rng: &mut Rng) -> Vec<RowSource> {
    let mut total = 0.0;
    let until: Vec<f64> = alive
        .iter()
        .map(|&i| {
            total += f64::from(opacity(i).max(0.0));
            total
        })
        .collect();
    let mut copies = vec![0usize; alive.len()];
    if total > 0.0 && total.is_finite() {
        for _ in 0..wanted {
            let at = total * f64::from(rng.uniform());
            copies[until.partition_point(|sum| *sum <= at).min(alive.len() - 1)] += 1;
        }
    }
    let row = |(&i, &n): (&usize, &usize)| if n > 0 { RowSource::Share(i) } else { RowSource::Keep(i) };
    let mut rows: Vec<RowSource> = alive.iter().zip(&copies).map(row).collect();
    rows.extend(alive.iter().zip(&copies).flat_map(|(&i, &n)| std::iter::repeat_n(RowSource::Share(i), n)));
    rows
}

/// Sets opacity and size of each Gaussian's shares so that together, at its position, they look like it (equation 9 of the
/// publication). `gaussians` are gathered by `rows`.
pub(super) fn share(rows: &[RowSource], gaussians: &mut HostGaussians) {
    let counts = counts(rows);
    // the shares of one Gaussian are equal, so each source is computed once: logit, and change of the log-scales
    let mut changes: BTreeMap<usize, (f32, f32)> = BTreeMap::new();
    for (j, row) in rows.iter().enumerate() {
        let RowSource::Share(i) = row else { continue };
        let (logit, smaller) = *changes.entry(*i).or_insert_with(|| {
            let (opacity, factor) = shared(sigmoid_f64(f64::from(gaussians.opacity_logits[j])), counts[i]);
            (logit_f64(opacity.clamp(LIMIT, 1.0 - LIMIT)) as f32, factor.ln() as f32)
        });
        gaussians.opacity_logits[j] = logit;
        gaussians.log_scales[3 * j..][..3].iter_mut().for_each(|s| *s += smaller);
    }
}

/// Lowers the largest opacities `[N]` of each Gaussian's shares likewise, so that what was copied is not copied again for
/// the opacity that it no longer has.
pub(super) fn share_opacities(rows: &[RowSource], opacities: &mut [f32]) {
    let counts = counts(rows);
    for (row, opacity) in rows.iter().zip(opacities) {
        if let RowSource::Share(i) = row {
            *opacity = each(f64::from(*opacity), counts[i]) as f32;
        }
    }
}

/// Returns the number of shares of each Gaussian that is shared.
fn counts(rows: &[RowSource]) -> BTreeMap<usize, usize> {
    let mut counts: BTreeMap<usize, usize> = BTreeMap::new();
    for row in rows {
        if let RowSource::Share(i) = row {
            *counts.entry(*i).or_default() += 1;
        }
    }
    counts
}

/// Returns the opacity of each of `count` coinciding Gaussians that together have `opacity`.
fn each(opacity: f64, count: usize) -> f64 {
    1.0 - (1.0 - opacity).powf(1.0 / count.min(MAX_SHARES) as f64)
}

/// Returns the opacity of each of `count` coinciding Gaussians that together have `opacity`, and their standard deviations
/// as a fraction of those of the Gaussian that they replace, chosen so that the integral of alpha along a line through the
/// centre is unchanged.
fn shared(opacity: f64, count: usize) -> (f64, f64) {
    let count = count.min(MAX_SHARES);
    let each = each(opacity, count);
    // sum over n shares and k of binomial(n - 1, k) (-1)^k each^(k + 1) / sqrt(k + 1)
    let mut integral = 0.0;
    for n in 0..count {
        let mut binomial = 1.0;
        for k in 0..=n {
            let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
            integral += sign * binomial * each.powi(k as i32 + 1) / ((k + 1) as f64).sqrt();
            binomial *= (n - k) as f64 / (k + 1) as f64;
        }
    }
    let factor = opacity / integral;
    (each, if factor.is_finite() && factor > 0.0 { factor } else { 1.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rng() -> Rng {
        Rng::new(1, 2, Purpose::Relocation)
    }

    #[test]
    fn copies_are_drawn_in_proportion_to_opacity() {
        let opacities = [0.0, 0.9, 0.3, f32::NAN, 0.0];
        let rows = plan(&[0, 1, 2, 4], |i| opacities[i], 4000, &mut rng());
        assert_eq!(rows[..4], [RowSource::Keep(0), RowSource::Share(1), RowSource::Share(2), RowSource::Keep(4)]);
        let of = |i: usize| rows[4..].iter().filter(|r| **r == RowSource::Share(i)).count();
        assert_eq!(of(1) + of(2), 4000);
        assert!((2900..3100).contains(&of(1)), "{}", of(1));
        assert_eq!(rows, plan(&[0, 1, 2, 4], |i| opacities[i], 4000, &mut rng()), "the same for one seed and step");
        assert_eq!(
            plan(&[0, 4], |i| opacities[i], 3, &mut rng()),
            [RowSource::Keep(0), RowSource::Keep(4)],
            "nothing to copy"
        );
        assert_eq!(plan(&[], |_| 1.0, 3, &mut rng()), []);
    }

    /// Alpha of `count` coinciding Gaussians at a distance of `x` standard deviations of the original from the centre.
    fn alpha(opacity: f64, scale: f64, count: usize, x: f64) -> f64 {
        1.0 - (1.0 - opacity * (-0.5 * (x / scale).powi(2)).exp()).powi(count as i32)
    }

    #[test]
    fn shares_look_like_the_one_that_they_replace() {
        for (opacity, count) in [(0.001, 2), (0.3, 2), (0.9, 3), (0.9, 20), (0.99, 51)] {
            let (each, factor) = shared(opacity, count);
            assert!((alpha(each, factor, count, 0.0) - opacity).abs() < 1e-9, "the same opacity in the centre");
            let along =
                |o: f64, s: f64, n: usize| (-800..=800).map(|k| alpha(o, s, n, 0.01 * f64::from(k))).sum::<f64>();
            let [before, after] = [along(opacity, 1.0, 1), along(each, factor, count)];
            assert!((after / before - 1.0).abs() < 1e-6, "{opacity} {count}: {before} {after}");
            assert!(factor <= 1.0 + 1e-9, "{factor}");
        }
        assert_eq!(shared(0.0, 3), (0.0, 1.0));
        assert_eq!(shared(0.5, 1), (0.5, 1.0));
        let (each, factor) = shared(0.9, 1000);
        assert!(each > 0.0 && factor > 0.0 && factor < 1.0);
    }

    #[test]
    fn kept_rows_stay_as_they_are() {
        let rows = [RowSource::Keep(0), RowSource::Share(1), RowSource::Share(1)];
        let mut g = HostGaussians {
            log_scales: [[-2.0; 3], [-1.0; 3], [-1.0; 3]].concat(),
            opacity_logits: vec![0.5, 2.0, 2.0],
            ..HostGaussians::default()
        };
        share(&rows, &mut g);
        assert_eq!((g.opacity_logits[0], &g.log_scales[..3]), (0.5, &[-2.0; 3][..]));
        assert_eq!((g.opacity_logits[1], &g.log_scales[3..6]), (g.opacity_logits[2], &g.log_scales[6..]));
        let together = 1.0 - (1.0 - sigmoid_f64(f64::from(g.opacity_logits[1]))).powi(2);
        assert!((together - sigmoid_f64(2.0)).abs() < 1e-6 && g.log_scales[3] < -1.0);
        for logit in [f32::INFINITY, f32::NEG_INFINITY, 100.0] {
            g.opacity_logits.fill(logit);
            share(&rows, &mut g);
            assert!(g.opacity_logits[1..].iter().chain(&g.log_scales).all(|v| v.is_finite()), "{logit}");
        }
    }
}
