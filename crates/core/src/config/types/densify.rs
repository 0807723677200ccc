//! `densify.*`: how the number of Gaussians changes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `densify.*`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DensifyConfig {
    /// Number of Gaussians that additions never exceed and, in `budget` mode, reach exactly. If there are already more,
    /// none are added and none are removed for this reason.
    pub budget: usize,
    /// The same for warm-up; 0 uses `budget`.
    pub warmup_budget: usize,
    /// How new Gaussians are chosen: those with the largest gradients, as many as needed to reach the budget along a
    /// straight line (`budget`); those above the threshold, as in 3DGS, limited by the budget (`threshold`); by relocation,
    /// as in 3DGS-MCMC: as many as in `budget` mode, and one for each that is removed, copied from Gaussians drawn in
    /// proportion to their opacity (`relocate`); none (`off`); or a registered rule, see `docs/research.md`.
    pub mode: String,
    /// Steps between densifications.
    pub every: usize,
    /// Gaussians are added only after this step of warm-up.
    pub warmup_from: usize,
    /// Last step of warm-up at which Gaussians are added or removed.
    pub warmup_until: usize,
    /// Gaussians are added only after this joint step.
    pub joint_from: usize,
    /// Last joint step after which Gaussians are added or removed; none are after the last step of the run.
    pub joint_until: usize,
    /// Mean norm of the screen-space gradient (normalised device coordinates) above which `threshold` mode adds
    /// Gaussians.
    pub threshold: f64,
    /// Gaussians larger than this fraction of the scene's extent are split, smaller ones are cloned.
    pub split_above: f64,
    /// Gaussians whose opacity, as defined by `prune_by`, is below this are removed; 0 keeps them.
    pub prune_opacity: f64,
    /// The opacity used by `prune_opacity`: the largest of a Gaussian since the last pruning (`largest`), or its
    /// current canonical one (`present`, as in 3DGS).
    pub prune_by: PruneBy,
    /// Gaussians larger than this fraction of the scene's extent are also removed, once opacities have been reset; 0
    /// keeps them.
    pub prune_size: f64,
    /// Steps between prunings.
    pub prune_every: usize,
    /// Gaussians are removed only after this step of warm-up, if it is later than `warmup_from`.
    pub prune_from: usize,
    /// Whether Gaussians are removed in the joint stage as well.
    pub prune_joint: bool,
    /// Warm-up step at which opacities are reset to at most 0.01; 0 for never.
    pub opacity_reset: usize,
    /// Opacities are reset again every `opacity_reset` steps up to this step of warm-up; 0 resets them only once.
    pub opacity_reset_until: usize,
    /// Whether the resets continue in the joint stage, up to the same step counted from the start of the run.
    pub opacity_reset_joint: bool,
}

impl Default for DensifyConfig {
    fn default() -> Self {
        Self {
            budget: 150_000,
            warmup_budget: 0,
            mode: "budget".into(),
            every: 100,
            warmup_from: 500,
            warmup_until: 14_900,
            joint_from: 1000,
            joint_until: 14_900,
            threshold: 2e-4,
            split_above: 0.01,
            prune_opacity: 0.005,
            prune_by: PruneBy::Largest,
            prune_size: 0.0,
            prune_every: 500,
            prune_from: 0,
            prune_joint: true,
            opacity_reset: 3000,
            opacity_reset_until: 0,
            opacity_reset_joint: false,
        }
    }
}

/// Which opacity decides whether a Gaussian is removed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PruneBy {
    /// The largest it was drawn with since the last pruning, at any time.
    Largest,
    /// Its current canonical opacity.
    Present,
}

impl DensifyConfig {
    /// Maximum number of Gaussians that additions in warm-up lead to.
    pub fn warmup_limit(&self) -> usize {
        if self.warmup_budget == 0 { self.budget } else { self.warmup_budget }
    }

    /// The larger of the two budgets.
    pub fn max_budget(&self) -> u128 {
        self.budget.max(self.warmup_limit()) as u128
    }
}
