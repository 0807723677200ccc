//! The `model` section of the configuration.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `model.*`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ModelConfig {
    /// Spherical-harmonics degree, 0 to 3, or 0, 2 or 4 with `sh_bands = "even"`; with `appearance = "headlight"` the
    /// degree of the residual after shading, 0 for none.
    pub sh_degree: usize,
    /// Bands of the spherical harmonics: `all` (as in 3DGS and the paper), or `even`: a colour is then the same from
    /// opposite sides, as under a headlight that shades both sides of a surface alike.
    pub sh_bands: ShBands,
    /// Colours as functions of direction (`sh`, as in 3DGS and the paper), or a base colour and a normal under a
    /// headlight (`headlight`).
    pub appearance: Appearance,
    /// The space-time encoder: `factorised` (the paper's: planes, lines and temporal vectors), `hexplane` (planes of space
    /// and time instead of its lines), `implicit` (the paper's ablation: a multi-layer perceptron on a positional
    /// encoding) or a registered one, see `docs/research.md`.
    pub encoder: String,
    /// Levels of the factorised encoder; level m has `m * resolution` nodes per axis.
    pub levels: usize,
    /// Nodes per axis of the first level.
    pub resolution: usize,
    /// Knots of the temporal vectors, or of the planes of space and time.
    pub time_knots: usize,
    /// Interpolation between these knots: `linear` (the paper's) or `cubic`, which is smooth.
    pub time_curve: TimeCurve,
    /// Channels of every plane, line and temporal vector.
    pub channels: usize,
    /// How planes and lines are initialised.
    pub grid_init: GridInit,
    /// Map time onto the whole temporal grid (`full`) or its second half (`half`, as in the reference code).
    pub time_range: TimeRange,
    /// The box that the grid covers: that of the visual hull (`hull`) or of the initial Gaussians (`points`).
    pub bounds: Bounds,
    /// Margin added around the box, as a fraction of its size.
    pub bounds_margin: f64,
    /// Octaves of the implicit encoder's input for a point p: p, sin(2^k p) and cos(2^k p), k from 0.
    pub implicit_octaves: usize,
    /// Octaves of time in the implicit encoder.
    pub implicit_time_octaves: usize,
    /// Width of the implicit encoder's layers, except the last, which outputs the `levels * channels` features.
    pub implicit_width: usize,
    /// Number of layers of the implicit encoder.
    pub implicit_depth: usize,
    /// Number of layers after which the implicit encoder's input is concatenated again; 0 for never.
    pub implicit_skip: usize,
    /// Length of the per-Gaussian embedding that the decoder receives with the features of place and time; 0 for
    /// none, as in the paper.
    pub embedding: usize,
    /// Variance added to each Gaussian on the screen, pixels squared, so that none falls between pixel centres; at
    /// least 0. 3DGS and the paper's code use 0.3, which blurs details one or two pixels wide.
    pub dilation: f64,
    /// How much a Gaussian's opacity follows the length of the ray's path through it: its optical depth is multiplied by
    /// this power of that length, relative to its mean axis. 0, as in 3DGS and the paper: the same from all sides; 1: as
    /// in a volume of constant density; at most 1.
    pub path_opacity: f64,
    /// Width of the decoder's hidden layers.
    pub width: usize,
    /// One hidden layer per output (`heads`, the paper's) or one for all (`shared`, cheaper).
    pub decoder: DecoderKind,
    /// Initialise the outputs to zero, so that joint training begins where warm-up ended.
    pub zero_init_heads: bool,
    /// How the decoder's biases are initialised.
    pub bias_init: BiasInit,
    /// Whether opacity changes over time.
    pub deform_opacity: bool,
}

impl Default for ModelConfig {
    fn default() -> Self {
        Self {
            sh_degree: 3,
            sh_bands: ShBands::All,
            appearance: Appearance::Sh,
            encoder: "factorised".into(),
            levels: 2,
            resolution: 64,
            time_knots: 25,
            time_curve: TimeCurve::Linear,
            channels: 32,
            grid_init: GridInit::Uniform,
            time_range: TimeRange::Full,
            bounds: Bounds::Points,
            bounds_margin: 0.0,
            // the network of D3DGS, see `model::encoder::implicit`
            implicit_octaves: 10,
            implicit_time_octaves: 6,
            implicit_width: 256,
            implicit_depth: 8,
            implicit_skip: 5,
            embedding: 0,
            dilation: 0.3,
            path_opacity: 0.0,
            width: 64,
            decoder: DecoderKind::Heads,
            zero_init_heads: false,
            bias_init: BiasInit::Uniform,
            deform_opacity: true,
        }
    }
}

/// Bands of the spherical harmonics.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ShBands {
    /// All up to the degree.
    All,
    /// The even ones up to the degree.
    Even,
}

/// What determines a Gaussian's colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Appearance {
    /// Spherical harmonics.
    Sh,
    /// Base colour, normal and one material for all, shaded by Blinn-Phong with a light at the eye; harmonics for the
    /// residual.
    Headlight,
}

/// How the grid is initialised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum GridInit {
    /// Planes and lines uniform in [0.1, 0.5], temporal vectors 1.
    Uniform,
    /// All zero, as in the reference code; needs `loss.one_prior`, as nothing is learnt otherwise.
    Zero,
}

/// Interpolation of temporal vectors between knots.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum TimeCurve {
    /// Linear.
    Linear,
    /// Catmull-Rom cubic.
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
    /// Bounding box of the initial Gaussians.
    Points,
}

/// The decoder's architecture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DecoderKind {
    /// One hidden layer each for mean, rotation, scale and opacity.
    Heads,
    /// One hidden layer for all.
    Shared,
}

/// How the decoder's biases are initialised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum BiasInit {
    /// Zero.
    Zero,
    /// Uniform in +-1 / sqrt(inputs), PyTorch's default; those of the outputs are zero with `zero_init_heads`.
    Uniform,
}
