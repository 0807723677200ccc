//! The configuration's section on the model.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

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
    /// The space-time encoder: `factorised` (the paper's), `hexplane` (planes of space and time in the place of its
    /// lines), `implicit` (the paper's ablation) or `extra` (a registered one).
    pub encoder: EncoderKind,
    /// Name of the registered encoder for `encoder = "extra"`, see `docs/research.md`; empty otherwise.
    #[serde(default)] // a scene from before this key still loads
    pub extra_encoder: String,
    /// Levels of the factorised encoder; level m has `m * resolution` nodes an axis.
    pub levels: usize,
    /// Nodes an axis of the first level.
    pub resolution: usize,
    /// Knots of the temporal vectors, or of the planes of space and time.
    pub time_knots: usize,
    /// How these go from knot to knot: `linear` (the paper's) or `cubic`, without corners.
    #[serde(default)] // a scene from before this key still loads
    pub time_curve: TimeCurve,
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
    #[serde(default = "super::defaults::implicit_time_octaves")]
    // a scene with another encoder from before these keys still loads
    pub implicit_time_octaves: usize,
    /// Width of its layers but the last, which gives the `levels * channels` features.
    #[serde(default = "super::defaults::implicit_width")]
    pub implicit_width: usize,
    /// How many layers it has.
    #[serde(default = "super::defaults::implicit_depth")]
    pub implicit_depth: usize,
    /// After so many of them its input goes in again; 0 for never.
    #[serde(default = "super::defaults::implicit_skip")]
    pub implicit_skip: usize,
    /// Numbers of each Gaussian's own that the decoder sees beside the features of its place and time; 0 for none, as the paper.
    #[serde(default)] // a scene from before this key still loads
    pub embedding: usize,
    /// Variance that each Gaussian is widened by on the screen, pixels squared, so that none falls between the centres of pixels;
    /// at least 0. 3DGS and the paper's code have 0.3, which blurs what is a pixel or two wide.
    #[serde(default = "super::defaults::dilation_of_3dgs")] // a scene from before this key still loads
    pub dilation: f64,
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
    /// Planes of space and planes of space and time, those of HexPlane.
    #[serde(rename = "hexplane")]
    HexPlane,
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

/// How temporal vectors go from knot to knot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum TimeCurve {
    /// Straight.
    #[default]
    Linear,
    /// On the cubic of Catmull and Rom.
    Cubic,
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
