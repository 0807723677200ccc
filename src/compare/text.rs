//! Tables as text and files: Markdown, LaTeX, CSV, JSON.

mod csv;
mod grid;
mod json;
mod latex;
mod markdown;
#[cfg(test)]
mod tests;

pub use csv::csv;
pub use grid::{TextCell, TextGrid, differences, results};
pub use json::json;
pub use latex::latex;
pub use markdown::markdown;
