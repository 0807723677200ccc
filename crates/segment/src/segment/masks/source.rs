//! Where masks come from: what a source receives of a view, and what it returns.
//!
//! One file per source: [`regions`] needs only the picture, [`labels`] reads the ground truth of a dataset, [`dir`]
//! the masks of other programs, and [`sam`] runs a network. Drawing the views and writing what is found is in `make`. A new
//! source is a file here and a line in [`MASK_SOURCES`]; a program adds its own by `volseggs::extend`.

pub mod dir;
pub mod labels;
pub mod regions;
pub mod sam;

use super::regions::RegionError;
use super::registry::MaskSourceKind;
use super::sam::SamError;
use super::{Mask, MaskError, StoreError};
use crate::data::DataError;
use crate::registry::Registry;
use crate::segment::pictures::GaussianPicture;
use thiserror::Error;

/// The source that is used unless another is named.
pub const DEFAULT: &str = "regions";

/// All sources, in the order in which they are listed.
pub static MASK_SOURCES: Registry<dyn MaskSourceKind> = Registry::new(
    "mask source",
    &[
        (DEFAULT, &regions::RegionsKind),
        ("labels", &labels::LabelsKind),
        ("dir", &dir::DirKind),
        ("sam", &sam::SamKind),
    ],
);

/// A segment to make masks of, drawn alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MaskGroup {
    /// Its name, as the mask file lists it.
    pub name: String,
    /// Its Gaussians, indices into those of the scene.
    pub members: Vec<u32>,
}

/// What a source receives of one view of one group.
#[derive(Clone, Copy, Debug)]
pub struct MaskInput<'a> {
    /// Which view: index into the job's shots.
    pub view: usize,
    /// Which group: index into the job's groups.
    pub group: usize,
    /// The group alone over the background.
    pub picture: &'a GaussianPicture,
    /// Pixels `[H, W]` where the group is in front in the whole scene; only for sources that need it.
    pub front: Option<&'a [bool]>,
}

/// A mask that a source found.
#[derive(Clone, Debug, PartialEq)]
pub struct ScoredMask {
    /// The mask, of the picture's size.
    pub mask: Mask,
    /// The source's estimate of how well the mask fits, 0 to 1.
    pub predicted_iou: f32,
    /// How little the mask changes when the source's thresholds do, 0 to 1.
    pub stability_score: f32,
}

/// Finds masks in pictures. The same picture gives the same masks, regardless of earlier calls.
pub trait MaskSource: Sync {
    /// Its name for readers of the mask file's header.
    fn name(&self) -> &str;

    /// The masks of one view of one group.
    ///
    /// # Errors
    /// As [`SourceError`].
    fn find(&self, seen: &MaskInput<'_>) -> Result<Vec<ScoredMask>, SourceError>;

    /// Whether [`MaskInput::front`] is needed, which costs a picture of the whole scene per view.
    fn needs_front(&self) -> bool {
        false
    }

    /// The best number of views to query at once; 1 for a source that uses all threads itself.
    fn batch_size(&self) -> usize {
        8
    }
}

/// Why a source cannot be opened, or finds no masks.
#[derive(Debug, Error)]
pub enum SourceError {
    /// The source `regions` failed.
    #[error(transparent)]
    Regions(#[from] RegionError),
    /// A mask is invalid.
    #[error(transparent)]
    Mask(#[from] MaskError),
    /// Masks of other programs cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Label images cannot be used.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The network failed.
    #[error(transparent)]
    Sam(#[from] SamError),
    /// The source was made for other views.
    #[error("view {view} of group {group}: the masks were opened for other views; open them for these")]
    View {
        /// The view asked for.
        view: usize,
        /// The group asked for.
        group: usize,
    },
    /// Any other reason.
    #[error("{0}")]
    Other(String),
}

impl SourceError {
    /// Whether input files are at fault.
    pub fn is_input(&self) -> bool {
        matches!(self, Self::Store(_) | Self::Data(_))
    }
}
