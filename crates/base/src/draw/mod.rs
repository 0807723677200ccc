//! Drawing on pictures, and plots as SVG: text, lines, scatter, parallel coordinates, sheets of views. Knows nothing of
//! what is drawn.

pub mod font;
mod frame;
pub mod parallel;
pub mod plot;
pub mod scatter;
pub mod views;
