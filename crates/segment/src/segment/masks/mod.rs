//! 2D masks of rendered images: what the fine segmentation lifts to 3D.
//!
//! The masks themselves ([`mask`], [`rle`]), their files ([`store`], [`coco`], [`png_folder`]), what finds them in a
//! picture ([`regions`], [`sam`]), clean-up ([`filter`], [`mod@alpha`]) and pictures of them ([`sheet`]) know nothing
//! of Gaussians. [`source`] gives these and the ground truth of a dataset one interface; [`make`] draws groups of
//! Gaussians, queries a source and writes the masks; [`registry`] has the sources by name; [`handout`] writes the
//! pictures for another program to segment.

pub mod alpha;
pub mod coco;
mod edges;
pub mod filter;
pub mod handout;
pub mod make;
pub mod mask;
mod merge;
pub mod png_folder;
mod reader;
pub mod regions;
pub mod registry;
pub mod rle;
pub mod sam;
pub mod sheet;
pub mod source;
pub mod store;
mod watershed;

pub use mask::{Mask, MaskError};
pub use regions::{RegionImage, RegionMask, find_regions};
pub use store::{Annotation, MaskFileHeader, MaskReader, MaskView, MaskWriter, StoreError};
