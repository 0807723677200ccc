//! Image metrics over plain RGB arrays. Nothing here knows of models or files of runs.

pub mod lpips;
pub mod psnr;
pub mod ssim;
