//! Options of an evaluation of segments, and why it can fail.

use super::method::Method;
use super::target::Union;
use crate::config::types::SegmentConfig;
use crate::data::DataError;
use crate::data::paths::Axis;
use crate::segment::baselines::saga::SagaOptions;
use crate::segment::masks::origin::MaskKind;

/// What to evaluate.
#[derive(Clone, Debug)]
pub struct SegmentOptions {
    /// Time of the clicks in [0, 1]; the nearest training time is used.
    pub time: f64,
    /// The methods.
    pub methods: Vec<Method>,
    /// Known segments to measure; all if empty.
    pub segments: Vec<String>,
    /// Known segments to measure as one, in addition to those.
    pub unions: Vec<Union>,
    /// Maximum number of clicks on a segment, each further one on what is still missing.
    pub clicks: usize,
    /// Whether to also find the settings that fit best in the clicked view, in addition to the fixed ones.
    pub oracle: bool,
    /// Source of the masks.
    pub masks: MaskKind,
    /// Number of views with masks; for [`MaskKind::Labels`] at most this many of the dataset's views.
    pub views: usize,
    /// Take these views within an angle (radians) of an axis, instead of on the whole sphere.
    pub bias: Option<(Axis, f64)>,
    /// The options of segmentation.
    pub config: SegmentConfig,
    /// Seed of the colours and of the affinity field.
    pub seed: u64,
    /// Training of SAGA.
    pub saga: SagaOptions,
    /// Minimum alpha of a pixel of a mask; that of the dataset's masks if `None`.
    pub mask_alpha: Option<f32>,
}

impl Default for SegmentOptions {
    /// What `eval --segments` and sweeps measure by default: every method, with one click on each segment.
    fn default() -> Self {
        Self {
            time: 0.5,
            methods: Method::ALL.to_vec(),
            segments: Vec::new(),
            unions: Vec::new(),
            clicks: 1,
            oracle: true,
            masks: MaskKind::Regions,
            views: 30,
            bias: None,
            config: SegmentConfig::default(),
            seed: 0,
            saga: SagaOptions::default(),
            mask_alpha: None,
        }
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
