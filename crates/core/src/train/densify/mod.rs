//! Adding and removing Gaussians: clone, split, prune and reset, to an exact budget.
//!
//! The plan is made on the host from statistics gathered over the steps, and is then applied alike to the attributes
//! and to the optimiser's moments.

mod relocate;
mod rule;

pub use rule::{Candidates, DensificationRule, check, find_rule, rule_of};

use super::due::DueChanges;
use crate::config::types::{Config, PruneBy};
use crate::model::HostGaussians;
use crate::model::params::HostTensor;
use crate::registry::Registry;
use crate::rng::{Purpose, Rng};
use std::collections::BTreeMap;
use volseggs_kernels::activation::sigmoid;

/// All rules, which `densify.mode` chooses from.
pub static RULES: Registry<dyn DensificationRule> = Registry::new(
    "densification rule",
    &[
        ("budget", &rule::Budget),
        ("threshold", &rule::Threshold),
        ("relocate", &relocate::Relocate),
        ("off", &rule::Off),
    ],
);

/// Statistics of each Gaussian between densifications.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Statistics {
    /// Sum of the norms of the screen-space gradient, in normalised device coordinates.
    pub gradient: Vec<f32>,
    /// Number of views that drew it.
    pub views: Vec<f32>,
    /// Largest opacity since the last pruning or reset.
    pub opacity: Vec<f32>,
}

impl Statistics {
    /// Returns empty statistics for `n` Gaussians.
    pub fn new(n: usize) -> Self {
        Self { gradient: vec![0.0; n], views: vec![0.0; n], opacity: vec![0.0; n] }
    }

    /// Adds a view: gradients `[N, 2]` in pixels of an image `width x height`, radii `[N]`.
    pub fn add_view(&mut self, gradient: &[f32], radii: &[i32], width: usize, height: usize) {
        let (sx, sy) = (0.5 * width as f32, 0.5 * height as f32);
        for (i, g) in gradient.chunks_exact(2).enumerate() {
            if radii[i] > 0 {
                self.gradient[i] += (g[0] * sx).hypot(g[1] * sy);
                self.views[i] += 1.0;
            }
        }
    }

    /// Records the opacities of a step, given as logits `[N]`.
    pub fn add_opacity(&mut self, logits: &[f32]) {
        for (largest, logit) in self.opacity.iter_mut().zip(logits) {
            *largest = largest.max(sigmoid(*logit));
        }
    }

    /// Returns the statistics of the Gaussians of `rows` once `due` is done. Gradients begin anew when Gaussians were added,
    /// opacities when some were pruned or opacities reset; the rest is kept.
    pub fn renewed(&self, rows: &[RowSource], due: DueChanges) -> Self {
        let mut new = Self::new(rows.len());
        if !due.adds() {
            (new.gradient, new.views) = (gather(&self.gradient, rows, 1), gather(&self.views, rows, 1));
        }
        if !due.prune && !due.reset {
            new.opacity = gather(&self.opacity, rows, 1);
            relocate::share_opacities(rows, &mut new.opacity);
        }
        new
    }

    /// Returns the statistics in the order of `rows`.
    pub fn rearranged(&self, rows: &[RowSource]) -> Self {
        let [gradient, views, opacity] = [&self.gradient, &self.views, &self.opacity].map(|v| gather(v, rows, 1));
        Self { gradient, views, opacity }
    }

    /// Returns the statistics as tensors for a checkpoint.
    pub fn into_tensors(self) -> BTreeMap<String, HostTensor> {
        let named = [("gradient", self.gradient), ("views", self.views), ("opacity", self.opacity)];
        let tensor = |values: Vec<f32>| HostTensor { shape: vec![values.len()], values };
        named.into_iter().map(|(name, values)| (format!("statistics.{name}"), tensor(values))).collect()
    }

    /// Restores the statistics of `n` Gaussians from [`Statistics::into_tensors`].
    ///
    /// # Errors
    /// A message naming what is missing or does not fit.
    pub fn from_tensors(tensors: &BTreeMap<String, HostTensor>, n: usize) -> Result<Self, String> {
        let of = |name: &str| {
            let values = tensors.get(&format!("statistics.{name}")).map(|t| t.values.clone());
            let values = values.filter(|v| v.len() == n);
            values.ok_or_else(|| format!("statistics.{name} is missing or does not have {n} entries"))
        };
        Ok(Self { gradient: of("gradient")?, views: of("views")?, opacity: of("opacity")? })
    }

    /// Returns the mean norm of the screen-space gradient of Gaussian `i` over the views that drew it; 0 if none did.
    pub fn score(&self, i: usize) -> f32 {
        if self.views[i] > 0.0 { self.gradient[i] / self.views[i] } else { 0.0 }
    }
}

/// Source of a row of the new arrays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RowSource {
    /// An old Gaussian, with its moments.
    Keep(usize),
    /// A copy of an old Gaussian, with moments of zero.
    Clone(usize),
    /// One of the two halves of an old Gaussian, with moments of zero.
    Half(usize),
    /// One of the Gaussians that together replace an old one, with moments of zero.
    Share(usize),
}

impl RowSource {
    /// Returns the index of the old Gaussian.
    pub fn source(self) -> usize {
        let (Self::Keep(i) | Self::Clone(i) | Self::Half(i) | Self::Share(i)) = self;
        i
    }
}

/// Plans the rows of the new arrays after `step` from the statistics, `opacity_logits` `[N]` and `log_scales` `[N, 3]`.
pub fn plan(
    step: usize,
    due: DueChanges,
    statistics: &Statistics,
    opacity_logits: &[f32],
    log_scales: &[f32],
    config: &Config,
    extent: f64,
) -> Vec<RowSource> {
    let d = &config.densify;
    let n = opacity_logits.len();
    let opacities: Vec<f32> = match d.prune_by {
        PruneBy::Largest => statistics.opacity.clone(),
        PruneBy::Present => opacity_logits.iter().map(|&logit| sigmoid(logit)).collect(),
    };
    let is_transparent = |i: usize| due.prune && f64::from(opacities[i]) < d.prune_opacity;
    let is_oversized = is_above(d.prune_size, extent, log_scales);
    let alive: Vec<usize> = (0..n).filter(|&i| !(is_transparent(i) || due.prune_large && is_oversized(i))).collect();
    // never prune all Gaussians
    let alive = if alive.is_empty() { (0..n).collect() } else { alive };
    let (alive, target, opacities) = (&alive[..], due.grow_to, &opacities[..]);
    let seen = Candidates { alive, count: n, target, statistics, opacities, log_scales, config, extent, step };
    rule_of(config).plan(&seen)
}

/// Whether any standard deviation of Gaussian `i` exceeds a fraction of the scene's extent.
fn is_above(fraction: f64, extent: f64, log_scales: &[f32]) -> impl Fn(usize) -> bool {
    let limit = (fraction * extent).ln() as f32;
    move |i: usize| log_scales[3 * i..3 * i + 3].iter().any(|&s| s > limit)
}

/// Gathers rows of a row-major array with `width` columns.
pub fn gather(values: &[f32], rows: &[RowSource], width: usize) -> Vec<f32> {
    rows.iter().flat_map(|r| &values[width * r.source()..][..width]).copied().collect()
}

/// Gathers rows of an optimiser moment; zero for new Gaussians.
pub fn gather_moments(values: &[f32], rows: &[RowSource], width: usize) -> Vec<f32> {
    let mut out = vec![0.0; rows.len() * width];
    for (target, row) in out.chunks_exact_mut(width).zip(rows) {
        if let RowSource::Keep(i) = row {
            target.copy_from_slice(&values[width * i..][..width]);
        }
    }
    out
}

/// Returns the new attributes. Halves are drawn from their parent's distribution and are 1.6 times smaller (3DGS); shares
/// together look nearly like their parent, see `relocate`.
pub fn apply(rows: &[RowSource], g: &HostGaussians, seed: u64, step: usize) -> HostGaussians {
    let mut out = g.map(|column| column.gather(rows.iter().map(|row| row.source())));
    relocate::share(rows, &mut out);
    let mut rng = Rng::new(seed, step as u64, Purpose::Split);
    for (j, row) in rows.iter().enumerate() {
        let by = match row {
            RowSource::Half(_) => 1.0,
            RowSource::Share(_) => relocate::APART,
            RowSource::Keep(_) | RowSource::Clone(_) => continue,
        };
        let offset = by * offset(&out, j, &mut rng);
        (0..3).for_each(|k| out.means[3 * j + k] += offset[k]);
        if matches!(row, RowSource::Half(_)) {
            out.log_scales[3 * j..][..3].iter_mut().for_each(|s| *s -= 1.6f32.ln());
        }
    }
    out
}

/// Draws an offset from the mean of Gaussian `j` by its distribution, scene units.
fn offset(g: &HostGaussians, j: usize, rng: &mut Rng) -> glam::Vec3 {
    let scales: [f32; 3] = std::array::from_fn(|k| g.log_scales[3 * j + k].exp());
    let local = glam::Vec3::from_array(scales.map(|s| s * rng.normal()));
    let [w, x, y, z] = std::array::from_fn(|k| g.rotations[4 * j + k]);
    let rotation = glam::Quat::from_xyzw(x, y, z, w);
    let rotation = if rotation.length_squared() > 1e-12 { rotation.normalize() } else { glam::Quat::IDENTITY };
    rotation * local
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::preset;

    fn gaussians(n: usize) -> HostGaussians {
        HostGaussians {
            means: (0..3 * n).map(|v| v as f32).collect(),
            rotations: [1.0, 0.0, 0.0, 0.0].repeat(n),
            log_scales: (0..3 * n).map(|i| if i / 3 % 2 == 0 { -9.0 } else { 0.0 }).collect(),
            opacity_logits: vec![0.0; n],
            sh: (0..12 * n).map(|v| v as f32).collect(),
            sh_stride: 4,
            ..HostGaussians::default()
        }
    }

    fn statistics(n: usize) -> Statistics {
        Statistics { gradient: (0..n).map(|i| (i + 1) as f32).collect(), views: vec![1.0; n], opacity: vec![0.5; n] }
    }

    fn planned(due: DueChanges, s: &Statistics, g: &HostGaussians, config: &Config) -> Vec<RowSource> {
        plan(7, due, s, &g.opacity_logits, &g.log_scales, config, 4.0)
    }

    #[test]
    fn growth_reaches_the_target_exactly_and_takes_the_largest_gradients() {
        let g = gaussians(10);
        let due = DueChanges { grow_to: Some(13), ..DueChanges::default() };
        let rows = planned(due, &statistics(10), &g, &preset("best").unwrap());
        assert_eq!(rows.len(), 13);
        // 7, 8 and 9 have the largest gradients; odd ones are large and are split, 8 is cloned
        assert_eq!(
            rows[7..],
            [
                RowSource::Half(7),
                RowSource::Keep(8),
                RowSource::Half(9),
                RowSource::Half(7),
                RowSource::Clone(8),
                RowSource::Half(9)
            ]
        );
        let out = apply(&rows, &g, 1, 2);
        assert_eq!(out.means[3 * 11..3 * 12], g.means[24..27]);
        assert!((out.log_scales[3 * 12] + 1.6f32.ln()).abs() < 1e-6);
        assert_ne!(out.means[3 * 7..3 * 8], out.means[3 * 10..3 * 11]);
        assert_eq!(gather_moments(&[1.0; 10], &rows, 1).iter().sum::<f32>(), 8.0);
    }

    #[test]
    fn pruning_makes_room_and_never_empties_the_scene() {
        let mut s = statistics(6);
        s.opacity[5] = 0.001;
        let due = DueChanges { grow_to: Some(6), prune: true, ..DueChanges::default() };
        let rows = planned(due, &s, &gaussians(6), &preset("best").unwrap());
        assert_eq!(rows.len(), 6);
        assert!(rows.iter().all(|r| r.source() != 5));
        s.opacity.fill(0.0);
        assert_eq!(planned(due, &s, &gaussians(6), &preset("best").unwrap()).len(), 6);
    }

    #[test]
    fn gradients_are_gathered_until_gaussians_are_added_and_opacities_until_some_are_pruned() {
        let s = statistics(3);
        let rows = [RowSource::Keep(0), RowSource::Keep(2)];
        let pruned = s.renewed(&rows, DueChanges { prune: true, ..DueChanges::default() });
        assert_eq!((&pruned.gradient[..], &pruned.views[..]), (&[1.0, 3.0][..], &[1.0; 2][..]));
        assert_eq!(pruned.opacity, [0.0; 2]);
        let reset = s.renewed(&[0, 1, 2].map(RowSource::Keep), DueChanges { reset: true, ..DueChanges::default() });
        assert_eq!((reset.gradient, reset.opacity), (s.gradient.clone(), vec![0.0; 3]));
        // what is shared no longer has the opacity of the whole: 1 - sqrt(1 - 0.75)
        let rows = [RowSource::Share(0), RowSource::Keep(2), RowSource::Share(0)];
        let whole = Statistics { opacity: vec![0.75, 0.5, 0.5], ..s };
        let added = whole.renewed(&rows, DueChanges { grow_to: Some(3), ..DueChanges::default() });
        assert_eq!((added.gradient, added.views), (vec![0.0; 3], vec![0.0; 3]));
        assert_eq!(added.opacity, [0.5; 3]);
    }

    #[test]
    fn current_opacity_and_size_decide_where_configured() {
        let (mut config, mut g, s) = (preset("best").unwrap(), gaussians(6), statistics(6));
        let kept = |config: &Config, g: &HostGaussians, due: DueChanges| -> Vec<usize> {
            planned(due, &s, g, config).into_iter().map(RowSource::source).collect()
        };
        g.opacity_logits[2] = -6.0; // 0.0025; its largest so far is 0.5
        let due = DueChanges { prune: true, ..DueChanges::default() };
        assert_eq!(kept(&config, &g, due), [0, 1, 2, 3, 4, 5]);
        config.densify.prune_by = PruneBy::Present;
        assert_eq!(kept(&config, &g, due), [0, 1, 3, 4, 5]);
        // odd ones have a standard deviation of 1: below 0.3 of the extent, above 0.2
        config.densify.prune_size = 0.3;
        let due = DueChanges { prune_large: true, ..DueChanges::default() };
        assert_eq!(kept(&config, &g, due), [0, 1, 2, 3, 4, 5]);
        config.densify.prune_size = 0.2;
        assert_eq!(kept(&config, &g, due), [0, 2, 4]);
    }

    #[test]
    fn relocation_keeps_the_number_and_grows_along_the_same_line() {
        let (mut config, mut s, mut g) = (preset("best").unwrap(), statistics(6), gaussians(6));
        config.densify.mode = "relocate".into();
        (s.opacity[5], g.opacity_logits[2]) = (0.001, 3.0);
        let planned = |due: DueChanges| planned(due, &s, &g, &config);
        assert_eq!(planned(DueChanges::default()), (0..6).map(RowSource::Keep).collect::<Vec<_>>());
        for due in [
            DueChanges { prune: true, ..DueChanges::default() },
            DueChanges { prune: true, grow_to: Some(3), ..DueChanges::default() },
        ] {
            let rows = planned(due);
            assert!(rows.len() == 6 && rows.iter().all(|r| r.source() != 5), "{rows:?}");
            assert_eq!(rows.iter().filter(|r| matches!(r, RowSource::Share(_))).count(), 2, "one and its copy");
        }
        let rows = planned(DueChanges { grow_to: Some(9), ..DueChanges::default() });
        assert_eq!(rows.len(), 9);
        // shares move apart, by less than their size; the others stay
        let out = apply(&rows, &g, 1, 2);
        for (j, row) in rows.iter().enumerate() {
            let (place, before) = (&out.means[3 * j..][..3], &g.means[3 * row.source()..][..3]);
            let moved = (0..3).map(|k| (place[k] - before[k]).abs()).fold(0.0, f32::max);
            match row {
                RowSource::Share(_) => assert!(moved > 0.0 && moved < 1.5 * out.log_scales[3 * j].exp(), "{moved}"),
                _ => assert_eq!(moved, 0.0),
            }
        }
        assert_eq!(
            gather_moments(&[1.0; 6], &rows, 1).iter().filter(|m| **m == 1.0).count(),
            rows.iter().filter(|r| matches!(r, RowSource::Keep(_))).count()
        );
    }

    #[test]
    fn above_the_budget_none_are_added_and_none_removed() {
        let due = DueChanges { grow_to: Some(4), ..DueChanges::default() };
        let rows = planned(due, &statistics(6), &gaussians(6), &preset("best").unwrap());
        assert_eq!(rows, (0..6).map(RowSource::Keep).collect::<Vec<_>>());
    }
}
