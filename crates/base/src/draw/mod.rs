//! Drawing on pictures, and plots as SVG: text, lines, scatter, parallel coordinates, sheets of views. Knows nothing of
//! what is drawn.

pub mod font;
mod frame;
pub mod parallel;
pub mod plot;
pub mod scatter;
pub mod views;

/// The smallest round number, 1, 2 or 5 times a power of ten, that is not below `raw` but for rounding; `raw` itself if
/// there is none, as beside the largest and smallest numbers.
pub fn round_step(raw: f64) -> f64 {
    let power = 10f64.powf(raw.log10().floor());
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|step| *step >= raw * 0.999).unwrap_or(raw)
}
