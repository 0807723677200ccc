//! Typed settings of a training run. Reading and layering them is left to `layers`.
//!
//! The defaults are the `best` preset. Every setting that the paper ablates has a key here.

pub(super) mod defaults;
mod densify;
pub mod methods;
mod model;
mod output;
pub mod segment;

pub use densify::{DensifyConfig, DensifyMode, PruneBy};
use methods::{CoordNetConfig, D3dgsConfig, FourDgsConfig, InSituNetConfig, VisNerfConfig};
pub use model::{
    Appearance, BiasInit, Bounds, DecoderKind, EncoderKind, GridInit, ModelConfig, ShBands, TimeCurve, TimeRange,
};
pub use output::OutputConfig;
pub use segment::SegmentConfig;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The name of this project's own method.
pub const VOLSEGGS: &str = "volseggs";

/// Configuration of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Seed of every random choice.
    pub seed: u64,
    /// The method: `volseggs` (that of the paper and of this project), `d3dgs`, `4dgs`, `coordnet`, `insitunet`,
    /// `visnerf` or a registered one, see `docs/reference.md`.
    #[serde(default = "defaults::method")] // runs that predate this key can still be opened
    pub method: String,
    /// Settings of a registered method, by name; see `docs/research.md`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub method_settings: BTreeMap<String, f64>,
    /// Images and background.
    pub data: DataConfig,
    /// The initial Gaussians.
    pub init: InitConfig,
    /// Gaussians and deformation field.
    pub model: ModelConfig,
    /// Lengths of the two stages.
    pub stages: StagesConfig,
    /// The loss.
    pub loss: LossConfig,
    /// Learning rates.
    pub optim: OptimConfig,
    /// How the number of Gaussians changes.
    pub densify: DensifyConfig,
    /// Time-saving options that may change the result.
    pub speed: SpeedConfig,
    /// Logs and checkpoints.
    pub output: OutputConfig,
    /// How a scene becomes segments; no step of training reads it.
    #[serde(default)] // sweeps train without it
    pub segment: SegmentConfig,
    /// Settings of the method `coordnet`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coordnet: Option<CoordNetConfig>,
    /// Settings of the method `insitunet`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub insitunet: Option<InSituNetConfig>,
    /// Settings of the method `visnerf`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub visnerf: Option<VisNerfConfig>,
    /// Settings of the method `d3dgs`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub d3dgs: Option<D3dgsConfig>,
    /// Settings of the method `4dgs`.
    #[serde(default, rename = "4dgs", skip_serializing_if = "Option::is_none")]
    pub fourdgs: Option<FourDgsConfig>,
}

/// `data.*`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DataConfig {
    /// Integer factor by which images are reduced (area filter, premultiplied alpha).
    pub downscale: u32,
    /// Background: `white`, `black`, `random` (a new colour each step; white in evaluation) or `#rrggbb`.
    pub background: String,
    /// Number of training times to train on, evenly spaced; 0 for all.
    pub times: usize,
    /// Train on the training times nearest to these, each in [0, 1], and evaluate on the views nearest to those times;
    /// empty for all. Cannot be combined with `times`.
    pub only_times: Vec<f64>,
    /// Number of views to train on per time, chosen as far apart as possible; 0 for all.
    pub views_per_time: usize,
    /// Each view once per round, reshuffled every round (`shuffled`), or a random view at every step (`independent`, as
    /// in the reference code).
    pub order: ViewOrder,
}

/// Which view a step uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ViewOrder {
    /// Every view once per round, each round in a new order.
    Shuffled,
    /// One drawn from all views, independently of earlier steps.
    Independent,
}

/// `init.*`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InitConfig {
    /// Number of initial Gaussians.
    pub points: usize,
    /// Where they are placed.
    pub placement: Placement,
    /// Half the side length of the cube for `placement = "box"`, scene units.
    pub box_half_size: f64,
    /// Initial standard deviation, as a multiple of the mean spacing.
    pub scale: f64,
    /// Initial opacity, in (0, 1).
    pub opacity: f64,
}

/// Where the initial Gaussians are placed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Placement {
    /// Inside the visual hull of the alpha masks of at least one time.
    Hull,
    /// Uniformly in a cube around the origin.
    Box,
}

/// `stages.*`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StagesConfig {
    /// Steps of warm-up, which trains the canonical Gaussians alone.
    pub warmup_steps: usize,
    /// Times used in warm-up.
    pub warmup_times: WarmupTimes,
    /// Steps of joint training; 0 trains a static scene, as plain 3DGS.
    pub joint_steps: usize,
    /// Steps of the run after which the spherical-harmonics degree rises by one, repeatedly; 0 starts at the full
    /// degree.
    pub sh_every: usize,
}

/// Times used in warm-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum WarmupTimes {
    /// The middle training time.
    Middle,
    /// All training times.
    All,
}

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
    /// Weights of registered loss terms, by name; see `docs/research.md`. 0 omits a term.
    pub extra: BTreeMap<String, f64>,
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

/// `optim.*`: Adam with one learning rate per parameter group.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OptimConfig {
    /// Learning rate of means, as a multiple of the scene's extent. It decays over the joint stage as set by
    /// `schedule`, and in warm-up over `warmup_decay_steps`.
    pub means: f64,
    /// Steps, from the start of warm-up, over which the rate of the means would decay to its final value; the decay
    /// restarts with the joint stage.
    pub warmup_decay_steps: usize,
    /// Learning rate of rotations.
    pub rotations: f64,
    /// Learning rate of log-scales.
    pub log_scales: f64,
    /// Learning rate of opacity logits.
    pub opacity: f64,
    /// Learning rate of the first spherical-harmonics coefficient.
    pub sh: f64,
    /// Learning rate of the other coefficients, as a fraction of `sh`.
    pub sh_rest: f64,
    /// Learning rate of the normals of `model.appearance = "headlight"`.
    pub normals: f64,
    /// Learning rate of the material of `model.appearance = "headlight"`.
    pub material: f64,
    /// Learning rate of planes, lines and temporal vectors, and of the other encoders (the implicit one needs a tenth;
    /// D3DGS uses 8e-4).
    pub encoder: f64,
    /// Learning rate of the decoder.
    pub decoder: f64,
    /// Learning rate of the per-Gaussian embedding, used if `model.embedding` is above 0.
    pub embedding: f64,
    /// Final rate of means, encoder, decoder and embedding, as a fraction of the initial rate.
    pub final_fraction: f64,
    /// Final rate of the other groups, as a fraction of the initial rate; they decay in the last stage of training, or
    /// over the whole run with `decay_over = "run"`.
    pub attributes_final_fraction: f64,
    /// How the rates of means, encoder, decoder and embedding decay: `log-linear`, `cosine`, `constant` or a registered
    /// schedule.
    pub schedule: String,
    /// Decay over each stage separately (`stage`, in warm-up over `warmup_decay_steps`), or once over the whole run
    /// (`run`, as in 3DGS).
    pub decay_over: DecayOver,
    /// First and second decay rates of Adam.
    pub betas: [f64; 2],
    /// Adam's epsilon.
    pub epsilon: f64,
    /// Length in steps of the moving average of the parameters that is shown and saved in their place; 0 for none. It
    /// covers at most a tenth of the steps since it began, and restarts with the joint stage, whenever Gaussians are
    /// added or removed, and when opacities are reset.
    #[serde(default)] // runs that predate this key can still be opened
    pub average: usize,
}

/// The period over which the rates decay.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DecayOver {
    /// Each stage separately.
    Stage,
    /// The whole run.
    Run,
}

/// `speed.*`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpeedConfig {
    /// Number of initial steps that use images reduced by `coarse_factor`.
    pub coarse_steps: usize,
    /// Integer factor by which these images are reduced.
    pub coarse_factor: u32,
    /// Steps between sorts of the Gaussians along a space-filling curve, with one at the start; 0 for never.
    pub sort_every: usize,
    /// Gaussians found transparent at a training time are skipped on later visits to that time; one visit in this many
    /// uses all Gaussians. 0 or 1 never skips. With `model.path_opacity`, their base opacities decide.
    pub cull_visits: usize,
}
