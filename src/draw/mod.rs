//! Drawing on pictures and plots as SVG: letters, line plots, sheets of views. Knows nothing of what is drawn.

pub mod font;
pub mod plot;
pub mod views;
