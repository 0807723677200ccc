//! `densify.*`: how the number of Gaussians changes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `densify.*`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DensifyConfig {
    /// Number of Gaussians that additions never exceed and, in `budget` mode, reach exactly. Where there are more already,
    /// none are added, and none removed for it.
    pub budget: usize,
    /// The same for warm-up; 0 for `budget`.
    pub warmup_budget: usize,
    /// How new Gaussians are chosen.
    pub mode: DensifyMode,
    /// Steps between densifications.
    pub every: usize,
    /// First step of warm-up after which Gaussians are added.
    pub warmup_from: usize,
    /// Last step of warm-up at which Gaussians are added or removed.
    pub warmup_until: usize,
    /// First joint step after which Gaussians are added.
    pub joint_from: usize,
    /// Last joint step at which Gaussians are added or removed.
    pub joint_until: usize,
    /// Mean norm of the screen-space gradient (normalised device coordinates) above which `threshold` mode adds.
    pub threshold: f64,
    /// Gaussians larger than this fraction of the scene's extent are split, smaller ones cloned.
    pub split_above: f64,
    /// Gaussians whose opacity, as `prune_by` takes it, is below this are removed; 0 keeps them.
    pub prune_opacity: f64,
    /// The largest opacity of a Gaussian since the last pruning (`largest`) or its present canonical one (`present`, 3DGS's).
    pub prune_by: PruneBy,
    /// Gaussians larger than this fraction of the scene's extent are removed with them, once opacities have been reset;
    /// 0 keeps them.
    pub prune_size: f64,
    /// Steps between prunings.
    pub prune_every: usize,
    /// Step of warm-up after which Gaussians are removed, if that is later than `warmup_from`.
    pub prune_from: usize,
    /// Whether they are removed in the joint stage as well.
    pub prune_joint: bool,
    /// Warm-up step at which opacities are reset to at most 0.01; 0 for never.
    pub opacity_reset: usize,
    /// They are reset again every `opacity_reset` steps up to this step of warm-up; 0 for once only.
    pub opacity_reset_until: usize,
    /// Whether that goes on in the joint stage, up to the same step counted from the first of the run.
    pub opacity_reset_joint: bool,
}

/// How new Gaussians are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DensifyMode {
    /// Those with the largest gradients, as many as a straight line towards the budget asks for.
    Budget,
    /// Those above the threshold, as in 3DGS, cut at the budget.
    Threshold,
    /// None are added.
    Off,
}

/// Which opacity decides whether a Gaussian is removed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PruneBy {
    /// The largest that it was drawn with since the last pruning, at whatever time.
    Largest,
    /// Its canonical one, as it is now.
    Present,
}

impl DensifyConfig {
    /// The number of Gaussians that warm-up adds up to.
    pub fn warmup_most(&self) -> usize {
        if self.warmup_budget == 0 { self.budget } else { self.warmup_budget }
    }
}
