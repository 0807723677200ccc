//! Options of an evaluation of segments: one struct for the library, `eval --segments` and the section `[segments]` of a
//! sweep. Why an evaluation can fail.

use super::method::Method;
use super::target::Union;
use crate::config::types::SegmentConfig;
use crate::config::types::segment::MaskScale;
use crate::data::DataError;
use crate::data::paths::Axis;
use crate::segment::baselines::saga::SagaOptions;
use crate::segment::masks::registry::{
    self, ChooseSourceError, ChosenSource, SourceOption, SourceOptions, SourceViews,
};
use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Maximum numbers of views with masks and of colours, above any reasonable need; with more, memory would run out.
const MAX_VIEWS: usize = 100_000;
const MAX_COLOURS: usize = 10_000;
/// Maximum number of clicks on a segment.
const MAX_CLICKS: usize = 1000;
/// Maximum number of pixels per step, which is how many are kept of a view.
const MAX_PIXELS: usize = 16_384;
/// Maximum number of points along a side of the grid that a network is asked at.
const MAX_POINTS: usize = 1000;

/// What to evaluate. In a sweep, the keys are `segments.*`, and paths are relative to the sweep file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Args)]
#[group(requires = "segments")]
#[serde(deny_unknown_fields, default)]
pub struct SegmentOptions {
    /// Methods: sagd, saga, coarse, fine, coarse+fine.
    #[arg(long, value_delimiter = ',', default_value = "sagd,saga,coarse,fine,coarse+fine")]
    #[serde(rename = "method", with = "methods")]
    pub methods: Vec<Method>,
    /// Maximum number of clicks on each segment; those after the first go on what is still missing in the clicked view.
    /// The ground truth places them.
    #[arg(long, value_name = "N", default_value_t = Self::default().clicks)]
    pub clicks: usize,
    /// Skip the oracle, which halves the time: it finds the settings that fit best in the clicked view.
    #[arg(long = "no-oracle", action = clap::ArgAction::SetFalse)]
    pub oracle: bool,
    /// Source of the masks.
    #[arg(long, value_parser = source_names(), default_value = registry::DEFAULT)]
    pub masks: String,
    /// For dir: the folder of masks, GROUP/VIEW_NUMBER.png, or the COCO file. The runs of a sweep share them, so they suit
    /// methods whose group is the whole scene, `scene`.
    #[arg(long, value_name = "PATH")]
    pub mask_dir: Option<PathBuf>,
    /// For sam: the weights; looked up in the cache folder if not given.
    #[arg(long, value_name = "FILE")]
    pub sam_weights: Option<PathBuf>,
    /// For sam: points along each side of the prompt grid [default: 32].
    #[arg(long, value_name = "N")]
    pub sam_points: Option<usize>,
    /// Known segments to measure; all if not given.
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    pub only: Vec<String>,
    /// Several known segments to click and measure as one, in addition to the others; may be repeated.
    #[arg(long = "score", value_name = "NAME=SEGMENT+SEGMENT")]
    #[serde(rename = "score")]
    pub unions: Vec<Union>,
    /// Time of the clicks in [0, 1]; the nearest training time is used.
    #[arg(skip = Self::default().time)]
    pub time: f64,
    /// Number of views with masks; for labels, at most this many of the dataset's views.
    #[arg(long = "mask-views", value_name = "N", default_value_t = Self::default().views)]
    pub views: usize,
    /// Restrict these views to those near an axis (x, y or z), instead of the whole sphere.
    #[arg(long = "mask-bias", value_name = "AXIS")]
    #[serde(with = "axis")]
    pub bias: Option<Axis>,
    /// Largest angle from that axis, degrees.
    #[arg(long = "mask-bias-angle", value_name = "DEGREES", default_value_t = Self::default().bias_angle)]
    pub bias_angle: f64,
    /// Number of colours (`segment.colour.clusters`); estimated from the data by default.
    #[arg(long, value_name = "K")]
    pub clusters: Option<usize>,
    /// Training steps of the affinity field (`segment.affinity.steps`) [default: 5000].
    #[arg(long, value_name = "N")]
    pub fine_steps: Option<usize>,
    /// Pixels per step of the affinity field; the paper uses 8192 (`segment.affinity.pixels`) [default: 2048].
    #[arg(long = "fine-pixels", value_name = "N")]
    pub pixels: Option<usize>,
    /// Margin of the contrastive loss; -1 is the paper's loss, which has none (`segment.affinity.margin`) [default: 0.5].
    #[arg(long, allow_negative_numbers = true)]
    pub margin: Option<f32>,
    /// Scale at which a training step queries the field: one drawn for all Gaussians, or that of each Gaussian's own
    /// mask, as in the paper (`segment.affinity.mask_scale`) [default: drawn].
    #[arg(long, value_name = "WHICH", value_enum)]
    pub mask_scale: Option<MaskScale>,
    /// Training steps of SAGA.
    #[arg(long, value_name = "N", default_value_t = Self::default().saga_steps)]
    pub saga_steps: usize,
    /// Minimum alpha of a silhouette's pixels; that of the dataset's masks if not given.
    #[arg(long, value_name = "ALPHA")]
    pub mask_alpha: Option<f32>,
    /// Seed of the clusters and fields. In a sweep, that of the run.
    #[arg(long, default_value_t = 0)]
    #[serde(skip)]
    pub seed: u64,
    /// The options of segmentation, `segment.*`; those above that are given as well replace some of them.
    #[arg(skip)]
    #[serde(skip_serializing_if = "SegmentConfig::is_default")]
    pub segment: SegmentConfig,
}

impl Default for SegmentOptions {
    /// Every method, with one click on each segment.
    fn default() -> Self {
        Self {
            methods: Method::ALL.to_vec(),
            clicks: 1,
            oracle: true,
            masks: registry::DEFAULT.to_owned(),
            mask_dir: None,
            sam_weights: None,
            sam_points: None,
            only: Vec::new(),
            unions: Vec::new(),
            time: 0.5,
            views: 30,
            bias: None,
            bias_angle: 45.0,
            clusters: None,
            fine_steps: None,
            pixels: None,
            margin: None,
            mask_scale: None,
            saga_steps: SagaOptions::default().steps,
            mask_alpha: None,
            seed: 0,
            segment: SegmentConfig::default(),
        }
    }
}

impl SegmentOptions {
    /// Returns the options of segmentation, those given directly included.
    #[must_use]
    pub fn config(&self) -> SegmentConfig {
        let mut config = self.segment.clone();
        config.colour.clusters = self.clusters.unwrap_or(config.colour.clusters);
        let affinity = &mut config.affinity;
        affinity.steps = self.fine_steps.unwrap_or(affinity.steps);
        affinity.pixels = self.pixels.unwrap_or(affinity.pixels);
        affinity.margin = self.margin.unwrap_or(affinity.margin);
        affinity.mask_scale = self.mask_scale.unwrap_or(affinity.mask_scale);
        config
    }

    /// Returns the options of SAGA's training.
    #[must_use]
    pub fn saga(&self) -> SagaOptions {
        SagaOptions { steps: self.saga_steps, seed: self.seed, ..SagaOptions::default() }
    }

    /// Returns the source of masks, after a check that its files exist.
    ///
    /// # Errors
    /// The option that is wrong.
    pub fn source(&self) -> Result<ChosenSource, OptionError> {
        let options =
            SourceOptions { path: self.mask_dir.clone(), weights: self.sam_weights.clone(), points: self.sam_points };
        let key = |option| match option {
            SourceOption::Path => "mask_dir",
            SourceOption::Weights => "sam_weights",
            SourceOption::Points => "sam_points",
        };
        ChosenSource::new(&self.masks, options).map_err(|error| match error {
            ChooseSourceError::Unknown { name } => {
                OptionError::new("masks", format!("\"{name}\" is not one of {}", registry::names()))
            }
            ChooseSourceError::NotRead { option, by } => {
                OptionError { only_for: Some(by), ..OptionError::new(key(option), String::new()) }
            }
            ChooseSourceError::Option(wrong) => OptionError::new(key(wrong.option), wrong.problem),
        })
    }

    /// Checks that each number is in its range, and that the masks can be had. Returns their source.
    ///
    /// # Errors
    /// The first option that is wrong.
    pub fn check(&self) -> Result<ChosenSource, OptionError> {
        let source = self.source()?;
        if self.bias.is_some() && source.views() == SourceViews::Labelled {
            let problem = "label images have the dataset's own views; use other masks";
            return Err(OptionError::new("bias", problem));
        }
        let counts = [
            ("views", Some(self.views), MAX_VIEWS),
            ("clicks", Some(self.clicks), MAX_CLICKS),
            ("fine_steps", self.fine_steps, usize::MAX),
            ("pixels", self.pixels, MAX_PIXELS),
            ("sam_points", self.sam_points, MAX_POINTS),
            ("saga_steps", Some(self.saga_steps), usize::MAX),
            ("clusters", self.clusters, MAX_COLOURS),
        ];
        for (key, value, most) in counts {
            match value {
                Some(0) => return Err(OptionError::value(key, 0, "must be at least 1")),
                Some(value) if value > most => {
                    return Err(OptionError::value(key, value, format!("must be at most {most}")));
                }
                _ => {}
            }
        }
        let numbers = [
            ("time", self.time, 0.0..=1.0),
            ("bias_angle", self.bias_angle, f64::MIN_POSITIVE..=180.0),
            ("mask_alpha", f64::from(self.mask_alpha.unwrap_or(1.0)), f64::MIN_POSITIVE..=1.0),
        ];
        if let Some((key, value, range)) = numbers.into_iter().find(|(_, value, range)| !range.contains(value)) {
            let above = if *range.start() > 0.0 { "above 0, at most" } else { "from 0 to" };
            return Err(OptionError::value(key, value, format!("must be {above} {}", range.end())));
        }
        self.config().check().map_err(|e| match short_of(e.key) {
            Some(key) => OptionError::value(key, e.value, format!("must be from {} to {}", e.low, e.high)),
            None => OptionError::new("segment", e.to_string()),
        })?;
        Ok(source)
    }
}

/// Returns the option that stands for a key of `segment`, if there is one.
fn short_of(key: &str) -> Option<&'static str> {
    match key {
        "colour.clusters" => Some("clusters"),
        "affinity.steps" => Some("fine_steps"),
        "affinity.pixels" => Some("pixels"),
        "affinity.margin" => Some("margin"),
        _ => None,
    }
}

/// An option that is wrong.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", self.of_key())]
pub struct OptionError {
    /// Its key in a sweep.
    pub key: &'static str,
    /// Its value, if that is a number.
    pub value: Option<String>,
    /// The masks that read it, if the chosen ones do not.
    pub only_for: Option<String>,
    /// What else is wrong.
    pub problem: String,
}

impl OptionError {
    fn new(key: &'static str, problem: impl Into<String>) -> Self {
        Self { key, value: None, only_for: None, problem: problem.into() }
    }

    fn value(key: &'static str, value: impl ToString, problem: impl Into<String>) -> Self {
        Self { value: Some(value.to_string()), ..Self::new(key, problem) }
    }

    /// Returns the message for a sweep, where the option is a key.
    fn of_key(&self) -> String {
        let key = self.key;
        match (&self.value, &self.only_for) {
            (Some(value), _) => format!("segments.{key} = {value}: {}", self.problem),
            (None, Some(masks)) => format!("segments.{key}: applies to masks = \"{masks}\" only"),
            (None, None) => format!("segments.{key}: {}", self.problem),
        }
    }

    /// Returns the message for the command line, where the option is a flag.
    #[must_use]
    pub fn of_flag(&self) -> String {
        let value = self.value.as_ref().map(|value| format!(" {value}")).unwrap_or_default();
        let flag = match self.key {
            "method" => "--methods".to_owned(),
            "views" => "--mask-views".to_owned(),
            "bias" => "--mask-bias".to_owned(),
            "bias_angle" => "--mask-bias-angle".to_owned(),
            "pixels" => "--fine-pixels".to_owned(),
            "segment" => "--set".to_owned(),
            key => format!("--{}", key.replace('_', "-")),
        };
        match &self.only_for {
            Some(masks) => format!("{flag}: only for --masks {masks}"),
            None => format!("{flag}{value}: {}", self.problem),
        }
    }
}

/// The names of all mask sources as values of an option, with a line of help each.
#[must_use]
pub fn source_names() -> PossibleValuesParser {
    let value = |(name, kind): (String, std::sync::Arc<dyn registry::MaskSourceKind>)| {
        PossibleValue::new(name).help(kind.help().to_owned())
    };
    registry::all().into_iter().map(value).collect::<Vec<_>>().into()
}

/// Methods as one text, their names separated by commas.
mod methods {
    use super::Method;
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};

    pub fn serialize<S: Serializer>(methods: &[Method], to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(&methods.iter().map(|method| method.name()).collect::<Vec<_>>().join(","))
    }

    pub fn deserialize<'a, D: Deserializer<'a>>(from: D) -> Result<Vec<Method>, D::Error> {
        String::deserialize(from)?.split(',').map(|name| name.trim().parse().map_err(D::Error::custom)).collect()
    }
}

/// An axis as text, empty for none.
mod axis {
    use super::Axis;
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};

    pub fn serialize<S: Serializer>(axis: &Option<Axis>, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(axis.map_or("", Axis::name))
    }

    pub fn deserialize<'a, D: Deserializer<'a>>(from: D) -> Result<Option<Axis>, D::Error> {
        let text = String::deserialize(from)?;
        if text.is_empty() { Ok(None) } else { text.parse().map(Some).map_err(D::Error::custom) }
    }
}

/// Why segments cannot be evaluated.
#[derive(Debug, thiserror::Error)]
pub enum SegmentEvalError {
    /// The dataset's information about its segments cannot be used.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The given masks cannot be used.
    #[error("masks: {0}")]
    Masks(String),
    /// The request cannot be met; other options can.
    #[error("{0}")]
    Input(String),
    /// A method failed.
    #[error("{0}")]
    Failed(String),
}

impl From<String> for SegmentEvalError {
    fn from(message: String) -> Self {
        Self::Failed(message)
    }
}

impl From<OptionError> for SegmentEvalError {
    fn from(error: OptionError) -> Self {
        Self::Input(error.to_string())
    }
}
