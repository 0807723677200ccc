//! Every choice of a training run, typed. Nothing is read or layered here; that is `layers`.
//!
//! The defaults are the `best` preset. Each key that the paper ablates is here by name.

mod defaults;
mod densify;
pub mod methods;
mod output;

pub use densify::{DensifyConfig, DensifyMode, PruneBy};
use methods::{CoordNetConfig, D3dgsConfig, FourDgsConfig, InSituNetConfig, VisNerfConfig};
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

/// `model.*`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ModelConfig {
    /// Spherical-harmonics degree, 0 to 3; with `appearance = "headlight"` of what shading leaves, 0 for none.
    pub sh_degree: usize,
    /// Colours written out over directions (`sh`, as 3DGS and the paper), or a base colour and a normal under a headlight
    /// (`headlight`).
    #[serde(default)] // a scene from before this key still loads
    pub appearance: Appearance,
    /// The space-time encoder: `factorised` (the paper's), `implicit` (its ablation) or `extra` (a registered one).
    pub encoder: EncoderKind,
    /// Name of the registered encoder for `encoder = "extra"`, see `docs/research.md`; empty otherwise.
    #[serde(default)] // a scene from before this key still loads
    pub extra_encoder: String,
    /// Levels of the factorised encoder; level m has `m * resolution` nodes an axis.
    pub levels: usize,
    /// Nodes an axis of the first level.
    pub resolution: usize,
    /// Knots of the temporal vectors.
    pub time_knots: usize,
    /// Channels of every plane, line and temporal vector.
    pub channels: usize,
    /// How planes and lines start.
    pub grid_init: GridInit,
    /// Map time onto the whole temporal grid (`full`) or its second half (`half`, as the reference code).
    pub time_range: TimeRange,
    /// The box that the grid covers: that of the visual hull (`hull`) or of the first Gaussians (`points`).
    pub bounds: Bounds,
    /// Margin added around the box, as a fraction of its size.
    pub bounds_margin: f64,
    /// Octaves of a point in the implicit encoder, which sees p, sin(2^k p) and cos(2^k p), k from 0.
    pub implicit_octaves: usize,
    /// Octaves of time there.
    #[serde(default = "defaults::implicit_time_octaves")]
    // a scene with another encoder from before these keys still loads
    pub implicit_time_octaves: usize,
    /// Width of its layers but the last, which gives the `levels * channels` features.
    #[serde(default = "defaults::implicit_width")]
    pub implicit_width: usize,
    /// How many layers it has.
    #[serde(default = "defaults::implicit_depth")]
    pub implicit_depth: usize,
    /// After so many of them its input goes in again; 0 for never.
    #[serde(default = "defaults::implicit_skip")]
    pub implicit_skip: usize,
    /// Width of the decoder's hidden layers.
    pub width: usize,
    /// One hidden layer for each output (`heads`, the paper's) or one for all (`shared`, cheaper).
    pub decoder: DecoderKind,
    /// Start the outputs at zero, so that joint training begins where warm-up ended.
    pub zero_init_heads: bool,
    /// How the decoder's biases start.
    #[serde(default)] // a scene from before this key still loads
    pub bias_init: BiasInit,
    /// Whether opacity changes over time.
    pub deform_opacity: bool,
}

/// What gives a Gaussian its colour.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Appearance {
    /// Spherical harmonics.
    #[default]
    Sh,
    /// Base colour, normal and a material of all, shaded by Blinn-Phong with a light at the eye; harmonics for the rest.
    Headlight,
}

/// The space-time encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum EncoderKind {
    /// Planes, lines and temporal vectors.
    Factorised,
    /// A multi-layer perceptron on a positional encoding.
    Implicit,
    /// The one registered as `model.extra_encoder`.
    Extra,
}

/// How the grid starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum GridInit {
    /// Planes and lines uniform in [0.1, 0.5], temporal vectors 1.
    Uniform,
    /// All zero, as the reference code; needs `loss.one_prior`, or nothing is ever learnt.
    Zero,
}

/// How time maps onto the temporal grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum TimeRange {
    /// [0, 1] onto all knots.
    Full,
    /// [0, 1] onto the second half of the knots.
    Half,
}

/// The box of the grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Bounds {
    /// Bounding box of the visual hull.
    Hull,
    /// Bounding box of the first Gaussians.
    Points,
}

/// The decoder's shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DecoderKind {
    /// A hidden layer for each of mean, rotation, scale and opacity.
    Heads,
    /// One hidden layer for all.
    Shared,
}

/// How the decoder's biases start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum BiasInit {
    /// At zero.
    #[default]
    Zero,
    /// Uniform in +-1 / sqrt(inputs), PyTorch's default; those of the outputs at zero with `zero_init_heads`.
    Uniform,
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
    /// The spherical-harmonics degree rises by one every so many steps, in each stage; 0 starts at the top.
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
    /// Final rate of means, encoder and decoder, as a fraction of the first.
    pub final_fraction: f64,
    /// Final rate of the other groups, as a fraction of the first.
    pub attributes_final_fraction: f64,
    /// How means, encoder and decoder fall: `log-linear`, `cosine`, `constant` or a registered schedule.
    pub schedule: String,
    /// Over each stage anew (`stage`, in warm-up over `warmup_decay_steps`), or once over the whole run (`run`, as 3DGS).
    pub decay_over: DecayOver,
    /// First and second decay of Adam.
    pub betas: [f64; 2],
    /// Adam's epsilon.
    pub epsilon: f64,
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
