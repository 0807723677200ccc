//! Published segmentation methods to compare with, over the same masks and the same scene: [`saga`] learns a feature
//! for each Gaussian, [`sagd`] learns nothing and votes.
//!
//! Both are written anew from what their papers and the settings in the VolSegGS paper say; each module lists where it
//! differs. Nothing here is used by the project's own segmentation.

pub mod saga;
pub mod sagd;
