//! Image metrics on plain RGB arrays, and the table of them. This module knows nothing of models or run files.
//!
//! A built-in metric is a file here with its function and its [`Metric`], and a line in [`METRICS`]; a program adds its own
//! by `volseggs::extend`.

pub mod lpips;
pub mod metric;
pub mod psnr;
pub mod ssim;
pub mod values;

use crate::registry::Registry;
use lpips::{LpipsMetric, LpipsNet};
use metric::Metric;

/// All metrics. The first is the headline: progress, labels and plots over time show it.
pub static METRICS: Registry<dyn Metric> = Registry::new(
    "metric",
    &[
        ("psnr", &psnr::Psnr),
        ("ssim", &ssim::Ssim { of_gray: false }),
        ("ssim_gray", &ssim::Ssim { of_gray: true }),
        ("lpips_alex", &LpipsMetric(LpipsNet::Alex)),
        ("lpips_vgg", &LpipsMetric(LpipsNet::Vgg)),
    ],
);
