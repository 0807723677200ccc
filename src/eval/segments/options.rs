//! Options of an evaluation of segments: one struct for the library, `eval --segments` and the section `[segments]` of a
//! sweep. Why an evaluation can fail.

use super::method::SelectionMethod;
use super::target::TargetUnion;
use crate::config::types::SegmentConfig;
use crate::config::types::segment::MaskScale;
use crate::data::DataError;
use crate::data::paths::Axis;
use crate::numbers::{cosine_f32, count, fraction_f32};
use crate::segment::baselines::saga::SagaOptions;
use crate::segment::masks::registry::{
    ChooseSourceError, ChosenSource, DEFAULT_POINTS, SourceOption, SourceOptions, SourceViews,
};
use crate::segment::masks::source::{self, MASK_SOURCES};
use clap::builder::{PossibleValue, PossibleValuesParser};
use clap::{ArgAction, Args};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Maximum numbers of views with masks and of colours, above any reasonable need; with more, memory would run out.
const MAX_VIEWS: f64 = 100_000.0;
const MAX_COLOURS: f64 = 10_000.0;
/// Maximum number of clicks on a segment.
const MAX_CLICKS: f64 = 1000.0;
/// Maximum number of pixels per step, which is how many are kept of a view.
const MAX_PIXELS: f64 = 16_384.0;
/// Maximum number of points along a side of the grid that a network is asked at.
const MAX_POINTS: f64 = 1000.0;
/// The smallest number of a range that excludes 0.
const ABOVE_0: f64 = f64::MIN_POSITIVE;

/// What to evaluate. In a sweep, the keys are `segments.*`, and paths are relative to the sweep file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Args)]
#[group(requires = "segments")]
#[serde(deny_unknown_fields, default)]
pub struct SegmentEvalOptions {
    /// Methods: sagd, saga, coarse, fine, coarse+fine.
    // a variant of a sweep measures one
    #[arg(long, value_delimiter = ',', default_value = "sagd,saga,coarse,fine,coarse+fine")]
    #[serde(rename = "method", with = "one_method", default = "one_method::default")]
    pub methods: Vec<SelectionMethod>,
    /// Source of the masks.
    #[arg(long, value_parser = mask_source_names(), default_value = source::DEFAULT)]
    pub masks: String,
    /// For dir: the folder of masks, GROUP/VIEW_NUMBER.png, or the COCO file.
    // the runs of a sweep share them, so they suit methods whose group is the whole scene, `scene`
    #[arg(long, value_name = "PATH")]
    pub mask_dir: Option<PathBuf>,
    /// For sam: the weights; looked up in the cache folder if not given.
    #[arg(long, value_name = "FILE")]
    pub sam_weights: Option<PathBuf>,
    /// For sam: points along each side of the prompt grid.
    #[arg(long, value_name = "N", default_value_t = DEFAULT_POINTS, value_parser = count)]
    pub sam_points: usize,
    /// Number of views with masks; for labels, at most this many of the dataset's views.
    // `eval` has views of its own
    #[arg(id = "mask_views", long = "mask-views", value_name = "MASK_VIEWS", default_value_t = Self::default().views, value_parser = count)]
    pub views: usize,
    /// Restrict these views to within 45 degrees of an axis (x, y or z), instead of the whole sphere.
    #[arg(long = "mask-bias", value_name = "AXIS")]
    #[serde(with = "axis")]
    pub bias: Option<Axis>,
    /// Maximum angle from that axis, degrees.
    #[arg(skip = Self::default().bias_angle)]
    pub bias_angle: f64,
    /// Time of the clicks in [0, 1]; the nearest training time is used.
    #[arg(skip = Self::default().time)]
    pub time: f64,
    /// Known segments to measure; all if not given.
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    pub only: Vec<String>,
    /// Several known segments to click and measure as one, in addition to the others; may be repeated.
    #[arg(long = "score", value_name = "NAME=SEGMENT+SEGMENT")]
    #[serde(rename = "score")]
    pub unions: Vec<TargetUnion>,
    /// Skip the oracle, which halves the time.
    #[arg(long = "no-oracle", action = ArgAction::SetFalse)]
    pub oracle: bool,
    /// Maximum number of clicks on each segment; those after the first go on what is still missing in the clicked view.
    /// The ground truth places them.
    #[arg(long, default_value_t = Self::default().clicks, value_parser = count)]
    pub clicks: usize,
    /// Number of colours (`segment.colour.clusters`); estimated from the data by default.
    #[arg(long, value_name = "K", value_parser = count)]
    pub clusters: Option<usize>,
    /// Training steps of the affinity field (`segment.affinity.steps`) [default: 5000].
    #[arg(long, value_name = "N", value_parser = count)]
    pub fine_steps: Option<usize>,
    /// Training steps of SAGA.
    #[arg(long, default_value_t = Self::default().saga_steps, value_parser = count)]
    pub saga_steps: usize,
    /// Pixels per step of the affinity field; the paper uses 8192 (`segment.affinity.pixels`) [default: 2048].
    #[arg(long = "fine-pixels", value_name = "N", value_parser = count)]
    pub pixels: Option<usize>,
    /// Margin of the contrastive loss; -1 is the paper's loss, which has none (`segment.affinity.margin`) [default: 0.5].
    #[arg(long, value_parser = cosine_f32, allow_negative_numbers = true)]
    pub margin: Option<f32>,
    /// Scale at which a training step queries the field: one drawn for all Gaussians, or that of each Gaussian's own
    /// mask, as in the paper (`segment.affinity.mask_scale`) [default: drawn].
    #[arg(long, value_name = "WHICH", value_enum)]
    pub mask_scale: Option<MaskScale>,
    /// Minimum alpha of a silhouette's pixels; that of the dataset's masks if not given.
    #[arg(long, value_name = "ALPHA", value_parser = fraction_f32)]
    #[serde(skip)]
    pub mask_alpha: Option<f32>,
    /// Seed of the clusters and fields.
    #[arg(long, default_value_t = 0)]
    #[serde(skip)]
    pub seed: u64,
    /// The options of segmentation, `segment.*`; those above that are given as well replace some of them.
    #[arg(skip)]
    #[serde(skip_serializing_if = "SegmentConfig::is_default")]
    pub segment: SegmentConfig,
}

impl Default for SegmentEvalOptions {
    /// Every method, with one click on each segment.
    fn default() -> Self {
        Self {
            methods: SelectionMethod::ALL.to_vec(),
            masks: source::DEFAULT.to_owned(),
            mask_dir: None,
            sam_weights: None,
            sam_points: DEFAULT_POINTS,
            views: 30,
            bias: None,
            bias_angle: 45.0,
            time: 0.5,
            only: Vec::new(),
            unions: Vec::new(),
            oracle: true,
            clicks: 1,
            clusters: None,
            fine_steps: None,
            saga_steps: SagaOptions::default().steps,
            pixels: None,
            margin: None,
            mask_scale: None,
            mask_alpha: None,
            seed: 0,
            segment: SegmentConfig::default(),
        }
    }
}

impl SegmentEvalOptions {
    /// Returns the options of segmentation, those given directly included.
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
    pub fn saga(&self) -> SagaOptions {
        SagaOptions { steps: self.saga_steps, seed: self.seed, ..SagaOptions::default() }
    }

    /// Returns the source of masks, after a check that its files exist.
    ///
    /// # Errors
    /// The option that is wrong.
    pub fn source(&self) -> Result<ChosenSource, SegmentOptionError> {
        let points = Some(self.sam_points).filter(|points| *points != DEFAULT_POINTS);
        let options = SourceOptions { path: self.mask_dir.clone(), weights: self.sam_weights.clone(), points };
        let key = |option| match option {
            SourceOption::Path => "mask_dir",
            SourceOption::Weights => "sam_weights",
            SourceOption::Points => "sam_points",
        };
        let masks = self.masks.clone();
        ChosenSource::new(&masks, options).map_err(|error| match error {
            ChooseSourceError::NotRead { option, by } => SegmentOptionError::NotRead { key: key(option), by, masks },
            ChooseSourceError::Missing { option, what } => {
                SegmentOptionError::Missing { key: key(option), what, masks }
            }
            ChooseSourceError::Unusable { option, problem } => {
                SegmentOptionError::Unusable { key: key(option), problem }
            }
            unknown @ ChooseSourceError::Unknown { .. } => {
                SegmentOptionError::Unusable { key: "masks", problem: unknown.to_string() }
            }
        })
    }

    /// Checks that each number is in its range, and that the masks can be had. Returns their source.
    ///
    /// # Errors
    /// The first option that is wrong.
    pub fn check(&self) -> Result<ChosenSource, SegmentOptionError> {
        let affinity = self.config().affinity;
        let ranges = [
            ("views", self.views as f64, 1.0..=MAX_VIEWS),
            ("clicks", self.clicks as f64, 1.0..=MAX_CLICKS),
            ("fine_steps", affinity.steps as f64, 1.0..=f64::MAX),
            ("pixels", affinity.pixels as f64, 1.0..=MAX_PIXELS),
            ("sam_points", self.sam_points as f64, 1.0..=MAX_POINTS),
            ("saga_steps", self.saga_steps as f64, 1.0..=f64::MAX),
            ("clusters", self.clusters.map_or(1.0, |n| n as f64), 1.0..=MAX_COLOURS),
            ("margin", f64::from(affinity.margin), -1.0..=1.0),
            ("time", self.time, 0.0..=1.0),
            ("bias_angle", self.bias_angle, ABOVE_0..=180.0),
            ("mask_alpha", f64::from(self.mask_alpha.unwrap_or(1.0)), ABOVE_0..=1.0),
        ];
        if let Some((key, value, range)) = ranges.into_iter().find(|(_, value, range)| !range.contains(value)) {
            let range = match (range.start(), range.end()) {
                (_, high) if value > *high => format!("at most {high}"),
                (low, _) if *low == ABOVE_0 => "above 0".to_owned(),
                (low, _) => format!("at least {low}"),
            };
            return Err(SegmentOptionError::Range { key, value, range });
        }
        let source = self.source()?;
        if let Some(path) = self.mask_dir.iter().find(|path| !path.exists()) {
            let problem = format!("{}: no such folder or file", path.display());
            return Err(SegmentOptionError::Unusable { key: "mask_dir", problem });
        }
        if self.bias.is_some() && source.kind.views() == SourceViews::Labelled {
            let problem = "label images have the dataset's own views; use other masks".to_owned();
            return Err(SegmentOptionError::Unusable { key: "bias", problem });
        }
        Ok(source)
    }
}

/// An option that is wrong. Keys are those of a sweep's section `[segments]`, without the prefix.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SegmentOptionError {
    /// A number is out of range.
    #[error("segments.{key} = {value}: must be {range}")]
    Range {
        /// The option.
        key: &'static str,
        /// Its value.
        value: f64,
        /// The bound that it misses, in words.
        range: String,
    },
    /// The chosen masks do not read it.
    #[error("segments.{key}: applies to masks = \"{by}\", not to \"{masks}\"")]
    NotRead {
        /// The option.
        key: &'static str,
        /// Masks that read it.
        by: String,
        /// The chosen ones.
        masks: String,
    },
    /// The chosen masks need it.
    #[error("segments.{key}: masks = \"{masks}\" needs {what}")]
    Missing {
        /// The option.
        key: &'static str,
        /// What it has to name.
        what: &'static str,
        /// The chosen masks.
        masks: String,
    },
    /// It cannot be used.
    #[error("segments.{key}: {problem}")]
    Unusable {
        /// The option.
        key: &'static str,
        /// Why.
        problem: String,
    },
}

/// Returns a parser of the names of all mask sources, which help lists with a line on each.
pub fn mask_source_names() -> PossibleValuesParser {
    let values =
        MASK_SOURCES.all().into_iter().map(|(name, kind)| PossibleValue::new(name).help(kind.help().to_owned()));
    values.collect::<Vec<_>>().into()
}

/// The methods as one name: a variant of a sweep measures one.
mod one_method {
    use super::SelectionMethod;
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};

    pub fn default() -> Vec<SelectionMethod> {
        vec![SelectionMethod::CoarseFine]
    }

    pub fn serialize<S: Serializer>(methods: &[SelectionMethod], to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(&methods.iter().map(|method| method.name()).collect::<Vec<_>>().join(","))
    }

    pub fn deserialize<'a, D: Deserializer<'a>>(from: D) -> Result<Vec<SelectionMethod>, D::Error> {
        String::deserialize(from)?.parse().map(|method| vec![method]).map_err(D::Error::custom)
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

impl From<SegmentOptionError> for SegmentEvalError {
    fn from(error: SegmentOptionError) -> Self {
        Self::Input(error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sweep_keeps_what_it_was_given() {
        let text = serde_json::to_string(&serde_json::from_str::<SegmentEvalOptions>("{}").unwrap()).unwrap();
        // names of measurements are digests of this
        assert_eq!(
            text,
            r#"{"method":"coarse+fine","masks":"regions","mask_dir":null,"sam_weights":null,"sam_points":32,"views":30,"bias":"","bias_angle":45.0,"time":0.5,"only":[],"score":[],"oracle":true,"clicks":1,"clusters":null,"fine_steps":null,"saga_steps":STEPS,"pixels":null,"margin":null,"mask_scale":null}"#
                .replace("STEPS", &SagaOptions::default().steps.to_string())
        );
        let given = r#"{"method":"saga","bias":"y","score":["pair=a+b"],"margin":-1.0,"pixels":64}"#;
        let options: SegmentEvalOptions = serde_json::from_str(given).unwrap();
        assert_eq!((&options.methods[..], options.bias), (&[SelectionMethod::Saga][..], Some(Axis::Y)));
        assert_eq!((options.unions[0].name.as_str(), options.config().affinity.pixels), ("pair", 64));
        let again: SegmentEvalOptions = serde_json::from_str(&serde_json::to_string(&options).unwrap()).unwrap();
        assert_eq!(again, options);
        for bad in [r#"{"method":"saga,fine"}"#, r#"{"bias":"w"}"#, r#"{"seed":1}"#, r#"{"score":["pair"]}"#] {
            assert!(serde_json::from_str::<SegmentEvalOptions>(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn numbers_out_of_range_are_named() {
        let bad = |options: SegmentEvalOptions| options.check().unwrap_err().to_string();
        let default = SegmentEvalOptions::default;
        assert!(default().check().is_ok());
        assert_eq!(bad(SegmentEvalOptions { views: 0, ..default() }), "segments.views = 0: must be at least 1");
        assert_eq!(bad(SegmentEvalOptions { time: f64::NAN, ..default() }), "segments.time = NaN: must be at least 0");
        assert_eq!(
            bad(SegmentEvalOptions { bias_angle: 0.0, ..default() }),
            "segments.bias_angle = 0: must be above 0"
        );
        assert_eq!(
            bad(SegmentEvalOptions { clicks: 9999, ..default() }),
            "segments.clicks = 9999: must be at most 1000"
        );
        let labels = SegmentEvalOptions { masks: "labels".to_owned(), bias: Some(Axis::X), ..default() };
        assert!(bad(labels).starts_with("segments.bias: label images"));
    }
}
