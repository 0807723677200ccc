//! Rules of densification: how many Gaussians there are to be, and which are copied or split for it. To add a built-in one,
//! write a file here with a [`DensificationRule`], and a line in [`RULES`].

use super::{RULES, RowSource, Statistics, is_above};
use crate::config::types::{Config, DensifyConfig};
use crate::registry::NotRegistered;
use crate::train::due::StepSpan;
use crate::train::schedule::Stage;

/// A rule of densification. What is removed, and at which steps either happens, is the same for all.
pub trait DensificationRule: Send + Sync {
    /// Returns the number of Gaussians to grow to at a step at which some may be added; `None` adds none. `line` is the
    /// value, at this step, of the straight line that ends at `densify.budget`.
    fn target(&self, _: &DensifyConfig, _: Stage, line: usize) -> Option<usize> {
        Some(line)
    }

    /// Plans the new Gaussians: those that are kept, each as [`RowSource::Keep`] or part of what replaces it, and the
    /// added ones.
    fn plan(&self, seen: &Candidates<'_>) -> Vec<RowSource>;

    /// Returns an upper bound of the number of Gaussians during a training. By default their number at most doubles each
    /// time some are added, and stays within `densify.budget`.
    fn max_gaussians(&self, config: &Config) -> u128 {
        let (start, d) = (config.init.points as u128, &config.densify);
        let [warmup, joint] = StepSpan::per_stage(config).map(|span| span.steps() / d.every.max(1));
        let times = warmup.saturating_add(joint).saturating_add(2);
        let doubled = start.saturating_mul(1u128.checked_shl(times.min(64) as u32).unwrap_or(u128::MAX));
        doubled.min(d.max_budget()).max(start)
    }

    /// Whether it ever adds Gaussians.
    fn adds(&self) -> bool {
        true
    }

    /// Whether it plans [`RowSource::Share`], which needs Gaussians whose opacity does not vary over time by itself.
    fn shares_opacity(&self) -> bool {
        false
    }

    /// Rejects settings with which it would have no effect, or another than stated.
    ///
    /// # Errors
    /// The first such key with its value, and what to do.
    fn check(&self, _: &Config) -> Result<(), String> {
        Ok(())
    }
}

/// What a rule chooses from.
#[derive(Clone, Copy)]
pub struct Candidates<'a> {
    /// The Gaussians that are not removed, ascending; of `count`.
    pub alive: &'a [usize],
    /// Number of Gaussians before any are removed.
    pub count: usize,
    /// Number to grow to; `None` if none are added now.
    pub target: Option<usize>,
    /// What was gathered since Gaussians were last added.
    pub statistics: &'a Statistics,
    /// Opacity of each Gaussian, as `densify.prune_by` defines it `[N]`.
    pub opacities: &'a [f32],
    /// Logarithms of the standard deviations along the axes, scene units `[N, 3]`.
    pub log_scales: &'a [f32],
    /// The configuration of the run.
    pub config: &'a Config,
    /// Extent of the scene, scene units.
    pub extent: f64,
    /// The step of the run after which it was due, from 0; random numbers are keyed by `config.seed` and the step.
    pub step: usize,
}

impl Candidates<'_> {
    /// Plans to copy those with the largest gradients above `threshold`, up to the target: large ones are split, small ones
    /// cloned.
    pub fn largest_gradients(&self, threshold: f32) -> Vec<RowSource> {
        let score = |i: usize| self.statistics.score(i);
        let wanted = self.target.map_or(0, |target| target.saturating_sub(self.alive.len()));
        let mut chosen: Vec<usize> = self.alive.iter().copied().filter(|&i| score(i) > threshold).collect();
        chosen.sort_by(|&a, &b| score(b).total_cmp(&score(a)).then(a.cmp(&b)));
        chosen.truncate(wanted);
        chosen.sort_unstable();

        let is_large = is_above(self.config.densify.split_above, self.extent, self.log_scales);
        let mut rows: Vec<RowSource> = Vec::with_capacity(self.alive.len() + chosen.len());
        let mut next = chosen.iter().copied().peekable();
        for &i in self.alive {
            let selected = next.next_if_eq(&i).is_some();
            rows.push(if selected && is_large(i) { RowSource::Half(i) } else { RowSource::Keep(i) });
        }
        rows.extend(chosen.into_iter().map(|i| if is_large(i) { RowSource::Half(i) } else { RowSource::Clone(i) }));
        rows
    }
}

/// Those with the largest gradients, as many as needed to reach the budget along a straight line.
pub(super) struct Budget;

impl DensificationRule for Budget {
    fn plan(&self, seen: &Candidates<'_>) -> Vec<RowSource> {
        seen.largest_gradients(0.0)
    }
}

/// Those with gradients above `densify.threshold`, as in 3DGS, limited by the budget.
pub(super) struct Threshold;

impl DensificationRule for Threshold {
    fn target(&self, densify: &DensifyConfig, stage: Stage, _: usize) -> Option<usize> {
        Some(if stage.is_joint() { densify.budget } else { densify.warmup_limit() })
    }

    fn plan(&self, seen: &Candidates<'_>) -> Vec<RowSource> {
        seen.largest_gradients(seen.config.densify.threshold as f32)
    }
}

/// None are added.
pub(super) struct Off;

impl DensificationRule for Off {
    fn target(&self, _: &DensifyConfig, _: Stage, _: usize) -> Option<usize> {
        None
    }

    fn plan(&self, seen: &Candidates<'_>) -> Vec<RowSource> {
        seen.alive.iter().copied().map(RowSource::Keep).collect()
    }

    fn max_gaussians(&self, config: &Config) -> u128 {
        config.init.points as u128
    }

    fn adds(&self) -> bool {
        false
    }

    fn check(&self, config: &Config) -> Result<(), String> {
        let (points, densify) = (config.init.points, &config.densify);
        let budgets = [("budget", densify.budget), ("warmup_budget", densify.warmup_budget)];
        match budgets.into_iter().find(|(_, budget)| *budget > points) {
            Some((key, budget)) => Err(format!(
                "densify.{key} = {budget}: none are added to init.points = {points} with densify.mode = \"off\"; set \
                 densify.{key} to {points}, or densify.mode to \"budget\""
            )),
            None => Ok(()),
        }
    }
}

/// Returns the rule of that name.
///
/// # Errors
/// [`NotRegistered`], which lists the registered names.
pub fn find_rule(name: &str) -> Result<&'static dyn DensificationRule, NotRegistered> {
    RULES.get(name)
}

/// Returns the rule `densify.mode`, whose name has been checked; none are added if there is no such rule.
pub fn rule_of(config: &Config) -> &'static dyn DensificationRule {
    find_rule(&config.densify.mode).unwrap_or(&Off)
}

/// Rejects a rule that does not exist or that rejects the settings.
///
/// # Errors
/// The first such key with its value, and what to do.
pub fn check(config: &Config) -> Result<(), String> {
    find_rule(&config.densify.mode).map_err(|e| format!("densify.mode: {e}"))?.check(config)
}
