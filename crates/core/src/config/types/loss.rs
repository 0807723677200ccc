//! `loss.*`: the terms of the loss and their weights.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// `loss.*`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LossConfig {
    /// Distance between colours.
    pub kind: LossKind,
    /// Weight of the distance, for both colours and alpha.
    pub weight: f64,
    /// Weight of DSSIM (1 - SSIM).
    pub dssim: f64,
    /// Number of final joint steps that use DSSIM (without a joint stage: final warm-up steps).
    pub dssim_last: usize,
    /// Number of these steps over which its weight rises from zero; 1 switches it on at once.
    pub dssim_ramp: usize,
    /// Whether DSSIM is used in all of warm-up as well, as in 3DGS.
    pub dssim_warmup: bool,
    /// Weight of the distance of alpha, relative to that of the colours.
    pub alpha: f64,
    /// Weight of total variation on planes and lines.
    pub tv: f64,
    /// Weight of total variation on temporal vectors.
    pub tv_time: f64,
    /// First differences on both axes (`first`, as in the paper) or second differences on one (`second`).
    pub tv_kind: TvOrder,
    /// Mean over the differences of each tensor (`mean`, as in the reference code) or their sum (`sum`, the paper's
    /// equation 6).
    pub tv_reduction: TvReduction,
    /// Weight of mean |1 - g| over the grid (the prior of the reference code).
    pub one_prior: f64,
    /// Weight of the fading penalty in the joint stage: the mean change of the Gaussians' opacities from their
    /// canonical values, so that the field prefers moving Gaussians to fading them. An addition of this project.
    pub fade: f64,
    /// Weights of the loss terms that have no key of their own, by name; see `docs/research.md`. 0 omits a term.
    pub extra: BTreeMap<String, f64>,
}

impl Default for LossConfig {
    fn default() -> Self {
        Self {
            kind: LossKind::L2,
            weight: 1.0,
            dssim: 0.2,
            dssim_last: 5000,
            dssim_ramp: 1,
            dssim_warmup: false,
            alpha: 0.0,
            tv: 1e-4,
            tv_time: 1e-4,
            tv_kind: TvOrder::First,
            tv_reduction: TvReduction::Mean,
            one_prior: 0.0,
            fade: 0.0,
            extra: BTreeMap::new(),
        }
    }
}

impl LossConfig {
    /// Returns name and weight of the first regulariser of the field's grid that is switched on; methods without a
    /// field refuse it.
    pub fn of_the_grid(&self) -> Option<(&'static str, f64)> {
        let all = [("tv", self.tv), ("tv_time", self.tv_time), ("one_prior", self.one_prior)];
        all.into_iter().find(|(_, weight)| *weight != 0.0)
    }
}

/// Distance between colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum LossKind {
    /// Mean absolute difference.
    L1,
    /// Mean squared difference.
    L2,
}

/// Order of total variation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum TvOrder {
    /// First differences on both axes.
    First,
    /// Second differences on one axis.
    Second,
}

/// How the squared differences of a tensor are reduced.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum TvReduction {
    /// Their mean.
    Mean,
    /// Their sum.
    Sum,
}
