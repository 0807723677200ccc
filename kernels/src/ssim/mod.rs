//! Structural similarity of two RGB images with its gradient.
//! Fast kernel in [`cpu`], oracle in [`mod@reference`].

pub mod cpu;
#[cfg(feature = "cube")]
mod cube;
mod ops;
pub mod reference;

#[cfg(test)]
mod tests;

pub use cpu::{ssim, ssim_grad};
pub use ops::{SsimForward, SsimOps, mean_ssim};

/// Taps of the Gaussian window.
const TAPS: usize = 11;
/// Taps on each side of the centre.
const RADIUS: usize = TAPS / 2;
/// Standard deviation of the window in pixels.
const SIGMA: f64 = 1.5;
/// Stabilisers of the mean and the variance term for values in [0, 1].
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Returns the window, normalised to sum 1.
fn window() -> [f64; TAPS] {
    let mut taps = [0.0; TAPS];
    for (i, tap) in taps.iter_mut().enumerate() {
        let x = i as f64 - RADIUS as f64;
        *tap = (-x * x / (2.0 * SIGMA * SIGMA)).exp();
    }
    let sum: f64 = taps.iter().sum();
    taps.map(|tap| tap / sum)
}
