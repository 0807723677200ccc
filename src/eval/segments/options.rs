//! What to evaluate, and why it cannot be.

use super::method::Method;
use super::target::Union;
use crate::data::DataError;
use crate::data::paths::Axis;
use crate::segment::baselines::saga::SagaOptions;
use crate::segment::coarse::CoarseOptions;
use crate::segment::fine::train::FineOptions;
use crate::segment::masks::origin::MaskKind;

/// What to evaluate.
#[derive(Clone, Debug)]
pub struct SegmentOptions {
    /// Time of the clicks in [0, 1]; the training time nearest to it is taken.
    pub time: f64,
    /// The methods.
    pub methods: Vec<Method>,
    /// Known segments to measure; all if empty.
    pub segments: Vec<String>,
    /// Known segments to measure as one, beside those.
    pub unions: Vec<Union>,
    /// Clicks on a segment at most, each further one on what is still missing.
    pub clicks: usize,
    /// Whether the settings that fit best in the clicked view are looked for too, beside the fixed ones.
    pub oracle: bool,
    /// Source of the masks.
    pub masks: MaskKind,
    /// Views with masks; not for [`MaskKind::Labels`], whose views are those of the dataset.
    pub views: usize,
    /// Take these views within an angle (radians) of an axis, in place of the whole sphere.
    pub bias: Option<(Axis, f64)>,
    /// Colours.
    pub coarse: CoarseOptions,
    /// Training of the affinity field.
    pub fine: FineOptions,
    /// Training of SAGA.
    pub saga: SagaOptions,
    /// Least alpha of a pixel of a mask; that of the dataset's masks if `None`.
    pub mask_alpha: Option<f32>,
}

impl Default for SegmentOptions {
    /// What `eval --segments` and sweeps measure if nothing else is said: every method, with one click on each segment.
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
            coarse: CoarseOptions::default(),
            fine: FineOptions::default(),
            saga: SagaOptions::default(),
            mask_alpha: None,
        }
    }
}

/// Why segments cannot be evaluated.
#[derive(Debug, thiserror::Error)]
pub enum SegmentEvalError {
    /// What the dataset knows of its segments cannot be used.
    #[error(transparent)]
    Data(#[from] DataError),
    /// Masks that were given cannot be used.
    #[error("masks: {0}")]
    Masks(String),
    /// What was asked for cannot be had; other options can.
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
