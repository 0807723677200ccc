//! Every choice of a training run, typed. Nothing is read or layered here; that is `layers`.
//!
//! The defaults are the `best` preset. Each key that the paper ablates is here by name.

pub(super) mod defaults;
mod densify;
pub mod methods;
mod model;
mod output;

pub use densify::{DensifyConfig, DensifyMode, PruneBy};
use methods::{CoordNetConfig, D3dgsConfig, FourDgsConfig, InSituNetConfig, VisNerfConfig};
pub use model::{Appearance, BiasInit, Bounds, DecoderKind, EncoderKind, GridInit, ModelConfig, TimeCurve, TimeRange};
pub use output::OutputConfig;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The name of our own method.
pub const VOLSEGGS: &str = "volseggs";

/// A training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Seed of every random choice.
    pub seed: u64,
    /// The method: `volseggs` (the paper's and ours), `d3dgs`, `4dgs`, `coordnet`, `insitunet`, `visnerf` or a registered
    /// one, see `docs/reference.md`.
    #[serde(default = "defaults::method")] // a run from before this key still opens
    pub method: String,
    /// Settings of a registered method by name, see `docs/research.md`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub method_settings: BTreeMap<String, f64>,
    /// Images and background.
    pub data: DataConfig,
    /// The first Gaussians.
    pub init: InitConfig,
    /// Gaussians and deformation field.
    pub model: ModelConfig,
    /// Length of the two stages.
    pub stages: StagesConfig,
    /// What is minimised.
    pub loss: LossConfig,
    /// Learning rates.
    pub optim: OptimConfig,
    /// How the number of Gaussians changes.
    pub densify: DensifyConfig,
    /// Savings of time that may change the result.
    pub speed: SpeedConfig,
    /// Logs and checkpoints.
    pub output: OutputConfig,
    /// Of the method `coordnet`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coordnet: Option<CoordNetConfig>,
    /// Of the method `insitunet`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub insitunet: Option<InSituNetConfig>,
    /// Of the method `visnerf`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub visnerf: Option<VisNerfConfig>,
    /// Of the method `d3dgs`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub d3dgs: Option<D3dgsConfig>,
    /// Of the method `4dgs`.
    #[serde(default, rename = "4dgs", skip_serializing_if = "Option::is_none")]
    pub fourdgs: Option<FourDgsConfig>,
}

/// `data.*`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DataConfig {
    /// Integer factor by which images are reduced (area filter, premultiplied alpha).
    pub downscale: u32,
    /// `white`, `black`, `random` (a new colour each step; white in evaluation) or `#rrggbb`.
    pub background: String,
    /// Train on so many of the training times, evenly spread; 0 for all.
    pub times: usize,
    /// Train on the training times nearest to these, each in [0, 1], and measure on the views nearest to those; empty for
    /// all. Not together with `times`.
    pub only_times: Vec<f64>,
    /// Train on so many views of each of them, as far apart as they can be chosen; 0 for all.
    pub views_per_time: usize,
    /// Each view once a round, shuffled anew (`shuffled`), or any view at any step (`independent`, the reference code's).
    pub order: ViewOrder,
}

/// Which view a step sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ViewOrder {
    /// Every view once a round, each round in an order of its own.
    Shuffled,
    /// One drawn from all, whichever came before.
    Independent,
}

/// `init.*`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InitConfig {
    /// Number of Gaussians at the start.
    pub points: usize,
    /// Where they lie.
    pub placement: Placement,
    /// Half side of the cube for `placement = "box"`, world units.
    pub box_half_size: f64,
    /// Standard deviation as a multiple of the mean spacing.
    pub scale: f64,
    /// Opacity in (0, 1).
    pub opacity: f64,
}

/// Where the first Gaussians lie.
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
    /// Steps of warm-up: canonical Gaussians alone.
    pub warmup_steps: usize,
    /// Times that warm-up sees.
    pub warmup_times: WarmupTimes,
    /// Steps of joint training; 0 trains a static scene, 3DGS as it is.
    pub joint_steps: usize,
    /// The spherical-harmonics degree rises by one every so many steps of the run; 0 starts at the top.
    pub sh_every: usize,
}

/// Times that warm-up sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum WarmupTimes {
    /// The middle training time.
    Middle,
    /// All of them.
    All,
}

/// `loss.*`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LossConfig {
    /// Distance between colours.
    pub kind: LossKind,
    /// Weight of the distance, of colours and alpha alike.
    pub weight: f64,
    /// Weight of DSSIM (1 - SSIM).
    pub dssim: f64,
    /// DSSIM counts in the last so many joint steps (without a joint stage: steps of warm-up).
    pub dssim_last: usize,
    /// Its weight rises from zero over the first so many of them; 1 switches it on at once.
    pub dssim_ramp: usize,
    /// Whether it counts in all of warm-up as well, as in 3DGS.
    pub dssim_warmup: bool,
    /// Distance of alpha, as a multiple of that of the colours.
    pub alpha: f64,
    /// Weight of total variation on planes and lines.
    pub tv: f64,
    /// Weight of total variation on temporal vectors.
    pub tv_time: f64,
    /// First differences on both axes (`first`, the paper's) or second differences on one (`second`).
    pub tv_kind: TvOrder,
    /// Mean over the differences of each tensor (`mean`, the reference code's) or their sum (`sum`, the paper's equation 6).
    pub tv_reduction: TvReduction,
    /// Weight of mean |1 - g| over the grid (the reference code's prior).
    pub one_prior: f64,
    /// Weight of fading in the joint stage: of the mean change of a Gaussian's opacity from its canonical one, so that the field
    /// rather moves what it can move; ours.
    pub fade: f64,
    /// Weights of registered loss terms by name, see `docs/research.md`; 0 leaves one out.
    pub extra: BTreeMap<String, f64>,
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

/// What becomes of the squared differences of a tensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum TvReduction {
    /// Their mean.
    Mean,
    /// Their sum.
    Sum,
}

/// `optim.*`: Adam with one learning rate a group.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OptimConfig {
    /// Means, as a multiple of the scene's extent, falling over the joint stage as `schedule` says, and in warm-up over
    /// `warmup_decay_steps`.
    pub means: f64,
    /// Steps, from the first of warm-up, over which the rate of the means would fall to its end; the joint stage begins anew.
    pub warmup_decay_steps: usize,
    /// Rotations.
    pub rotations: f64,
    /// Log-scales.
    pub log_scales: f64,
    /// Opacity logits.
    pub opacity: f64,
    /// First spherical-harmonics coefficient.
    pub sh: f64,
    /// Learning rate of the others, as a fraction of `sh`.
    pub sh_rest: f64,
    /// Normals of `model.appearance = "headlight"`.
    pub normals: f64,
    /// Its material.
    pub material: f64,
    /// Planes, lines and temporal vectors (and the other encoders; the implicit one wants a tenth, D3DGS has 8e-4).
    pub encoder: f64,
    /// The decoder.
    pub decoder: f64,
    /// The embedding of each Gaussian, of `model.embedding` above 0.
    pub embedding: f64,
    /// Final rate of means, encoder, decoder and embedding, as a fraction of the first.
    pub final_fraction: f64,
    /// Final rate of the other groups, as a fraction of the first; they fall in the stage that ends the training, or over the
    /// whole run with `decay_over = "run"`.
    pub attributes_final_fraction: f64,
    /// How means, encoder, decoder and embedding fall: `log-linear`, `cosine`, `constant` or a registered schedule.
    pub schedule: String,
    /// Over each stage anew (`stage`, in warm-up over `warmup_decay_steps`), or once over the whole run (`run`, as 3DGS).
    pub decay_over: DecayOver,
    /// First and second decay of Adam.
    pub betas: [f64; 2],
    /// Adam's epsilon.
    pub epsilon: f64,
    /// Steps that a moving average of the parameters reaches back, which is shown and saved in their place; 0 for none. It
    /// reaches back a tenth of the steps since it began at most, and begins again with the joint stage, and whenever
    /// Gaussians are added or removed.
    #[serde(default)] // a run from before this key still opens
    pub average: usize,
}

/// What the rates fall over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DecayOver {
    /// Each stage, beginning anew.
    Stage,
    /// The whole run.
    Run,
}

/// `speed.*`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpeedConfig {
    /// The first so many steps see images reduced by `coarse_factor`.
    pub coarse_steps: usize,
    /// Integer factor by which they are reduced.
    pub coarse_factor: u32,
    /// Steps between sortings of the Gaussians along a space-filling curve, also at the start; 0 for never.
    pub sort_every: usize,
    /// A Gaussian found transparent at a training time is passed over in the next visits of that time; one of so many
    /// looks at all. 0 or 1 for always.
    pub cull_visits: usize,
}
