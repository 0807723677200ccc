//! 2D masks of rendered images: what the fine segmentation lifts to 3D.
//!
//! The masks themselves ([`mask`], [`rle`]), their files ([`store`], [`coco`], [`png_folder`]), the source of masks that
//! needs no network ([`regions`]), clean-up ([`filter`]) and pictures of them ([`sheet`]). Nothing here knows of Gaussians.

pub mod coco;
mod edges;
pub mod filter;
pub mod mask;
mod merge;
pub mod png_folder;
mod reader;
pub mod regions;
pub mod rle;
pub mod sam;
pub mod sheet;
pub mod store;
mod watershed;

pub use mask::{Mask, MaskError};
pub use regions::{RegionImage, RegionMask, RegionOptions, find_regions};
pub use store::{Annotation, Header, MaskReader, MaskWriter, StoreError, View};
