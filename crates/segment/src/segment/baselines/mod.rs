//! Published segmentation methods for comparison, on the same masks and the same scene: [`saga`] learns a feature for
//! each Gaussian, [`sagd`] learns nothing and lets masks vote.
//!
//! Both are re-implemented from their papers and the settings in the VolSegGS paper; each module lists its differences.
//! Nothing here is used by the project's own segmentation.

pub mod saga;
pub mod sagd;
