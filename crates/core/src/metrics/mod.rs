//! Image metrics on plain RGB arrays. This module knows nothing of models or run files.

pub mod lpips;
pub mod psnr;
pub mod ssim;
