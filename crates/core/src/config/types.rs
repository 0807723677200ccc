//! Typed settings of a training run. Reading and layering them is left to `layers`.
//!
//! Each section has its defaults beside it. Together they are the method of the paper, as `configs/paper.toml` explains;
//! what this project adds is off. Every setting that the paper ablates has a key here.

mod d3dgs;
mod densify;
mod loss;
mod model;
mod optim;
mod output;
pub mod segment;

pub use d3dgs::D3dgsConfig;
pub use densify::{DensifyConfig, PruneBy};
pub use loss::{LossConfig, LossKind, TvOrder, TvReduction};
pub use model::{Appearance, BiasInit, Bounds, DecoderKind, GridInit, ModelConfig, ShBands, TimeCurve, TimeRange};
pub use optim::{DecayOver, OptimConfig};
pub use output::OutputConfig;
pub use segment::SegmentConfig;

use super::sections::{Sections, Settings};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The name of this project's own method.
pub const VOLSEGGS: &str = "volseggs";

/// Configuration of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(deny_unknown_fields)] // serde leaves them to `Sections`
pub struct Config {
    /// Seed of every random choice.
    pub seed: u64,
    /// The method: `volseggs` (that of the paper and of this project), another built-in one or a registered one, see
    /// `docs/reference.md`.
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
    /// Sections of single methods, by name.
    #[serde(flatten)]
    pub sections: Sections,
}

impl Config {
    /// Returns the settings of the method that has a section of its own.
    ///
    /// # Errors
    /// If the section is not given, or a value of it is of the wrong type.
    pub fn section<S: Settings>(&self) -> Result<S, String> {
        let name = S::SECTION;
        let none = || format!("method = \"{name}\" needs the section [{name}]: start with --method {name}");
        self.sections.get::<S>()?.ok_or_else(none)
    }
}

impl Default for Config {
    fn default() -> Self {
        Self {
            seed: 0,
            method: VOLSEGGS.into(),
            method_settings: BTreeMap::new(),
            data: DataConfig::default(),
            init: InitConfig::default(),
            model: ModelConfig::default(),
            stages: StagesConfig::default(),
            loss: LossConfig::default(),
            optim: OptimConfig::default(),
            densify: DensifyConfig::default(),
            speed: SpeedConfig::default(),
            output: OutputConfig::default(),
            segment: SegmentConfig::default(),
            sections: Sections::default(),
        }
    }
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

impl Default for DataConfig {
    fn default() -> Self {
        Self {
            downscale: 1,
            background: "white".into(),
            times: 0,
            only_times: Vec::new(),
            views_per_time: 0,
            order: ViewOrder::Shuffled,
        }
    }
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

impl Default for InitConfig {
    fn default() -> Self {
        Self { points: 100_000, placement: Placement::Box, box_half_size: 1.3, scale: 0.75, opacity: 0.1 }
    }
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

impl Default for StagesConfig {
    fn default() -> Self {
        Self { warmup_steps: 3000, warmup_times: WarmupTimes::All, joint_steps: 20_000, sh_every: 1000 }
    }
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

impl Default for SpeedConfig {
    fn default() -> Self {
        Self { coarse_steps: 0, coarse_factor: 2, sort_every: 1000, cull_visits: 0 }
    }
}
