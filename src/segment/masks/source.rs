//! Where masks come from: what a source is given of a view, and what it gives back.
//!
//! One file a source: [`regions`] needs nothing but the picture, [`labels`] reads the truth of a dataset, [`foreign`]
//! the masks of other programs, [`sam`] asks a network. Drawing the views and writing what is found is in `make`.

pub mod foreign;
pub mod labels;
pub mod regions;
pub mod sam;

use super::regions::RegionError;
use super::sam::SamError;
use super::{Mask, MaskError, StoreError};
use crate::data::DataError;
use crate::segment::pictures::Picture;
use thiserror::Error;

/// A segment to make masks of: it is drawn alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Group {
    /// Its name, as the mask file lists it.
    pub name: String,
    /// Its Gaussians, indices into those of the scene.
    pub members: Vec<u32>,
}

/// What a source is given of one view of one group.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a> {
    /// Which view: index into the job's shots.
    pub view: usize,
    /// Which group: index into the job's groups.
    pub group: usize,
    /// The group alone over the background.
    pub picture: &'a Picture,
    /// Pixels `[H, W]` where the group is what one sees in front in the whole scene; for sources that need it.
    pub front: Option<&'a [bool]>,
}

/// A mask that a source found.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// The mask, of the picture's size.
    pub mask: Mask,
    /// How well the source believes the mask fits, 0 to 1.
    pub predicted_iou: f32,
    /// How little the mask changes when the source's thresholds do, 0 to 1.
    pub stability_score: f32,
}

/// Something that finds masks in pictures. The same picture gives the same masks, whatever was asked before.
pub trait MaskSource: Sync {
    /// What it is, for people to read in the mask file's header.
    fn name(&self) -> &str;

    /// The masks of one view of one group.
    ///
    /// # Errors
    /// As [`SourceError`].
    fn find(&self, seen: &Seen<'_>) -> Result<Vec<Found>, SourceError>;

    /// Whether [`Seen::front`] is asked for, which costs a picture of the whole scene a view.
    fn needs_front(&self) -> bool {
        false
    }

    /// How many views it is best asked for at once; 1 for a source that uses all threads itself.
    fn side_by_side(&self) -> usize {
        8
    }
}

/// Why a source finds no masks.
#[derive(Debug, Error)]
pub enum SourceError {
    /// Of the source `regions`.
    #[error(transparent)]
    Regions(#[from] RegionError),
    /// A mask cannot be kept.
    #[error(transparent)]
    Mask(#[from] MaskError),
    /// Masks of other programs cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Label images cannot be used.
    #[error(transparent)]
    Data(#[from] DataError),
    /// Of the network.
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
}

impl SourceError {
    /// Whether files that were given are at fault.
    #[must_use]
    pub fn is_input(&self) -> bool {
        matches!(self, Self::Store(_) | Self::Data(_))
    }
}
