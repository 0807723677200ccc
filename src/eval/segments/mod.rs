//! How right segments are: selections made by one click, measured against the truth that `prepare` rendered.
//!
//! `truth` reads what is known, `target` says what is measured of it, `prompt` places the clicks, `train` makes what the
//! methods need. `setting` has each method's fixed setting, which is the headline, and the tries of the oracle; `select`
//! turns clicks into selections and knows no truth; `oracle` chooses among selections by the clicked view. `volume`
//! compares selections in space, `measure` in pictures; `result` has what was found and its means, `table` writes it
//! down, and `run` does one after the other.

mod click;
mod measure;
mod method;
mod options;
mod oracle;
mod prompt;
mod result;
mod run;
mod select;
mod setting;
mod table;
mod target;
mod train;
mod truth;
mod volume;

pub use method::Method;
pub use options::{SegmentEvalError, SegmentOptions};
pub use result::{Means, MethodMeans, Outcome, Row, SegmentEvaluation, SegmentResult, VolumeScore};
pub use run::evaluate_segments;
pub use setting::TRIES;
pub use table::{KIND, markdown, write_results};
pub use target::Union;
pub use train::write_mask_pictures;
