//! How right segments are: selections made by one click, measured against the truth that `prepare` rendered, in the
//! shape of the paper's tables.
//!
//! `truth` reads what is known, `prompt` chooses the click and judges what it selects as its user would, `train`
//! makes what the methods need, `methods` makes selections by each method, `measure` compares them with the truth, `table` writes them down, and `run` does
//! one after the other.

mod measure;
mod methods;
mod prompt;
mod run;
mod table;
mod train;
mod truth;

pub use measure::FrameScore;
pub use methods::Method;
pub use run::{MaskKind, SegmentEvalError, SegmentEvaluation, SegmentOptions, evaluate_segments};
pub use table::{KIND, Row, markdown, write_results};
