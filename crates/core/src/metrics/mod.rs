//! Image metrics on plain RGB arrays, and the table of them. This module knows nothing of models or run files.

pub mod lpips;
pub mod metric;
pub mod psnr;
pub mod ssim;
pub mod values;
