//! Accuracy of segments: selections made by one click, measured against the ground truth that `prepare` rendered.
//!
//! `truth` reads the ground truth, `target` defines what is measured of it, `prompt` places the clicks, and `train`
//! makes what the methods need. `setting` has each method's fixed setting, which gives the headline figures, and the
//! tries of the oracle; `select` turns clicks into selections without knowing the ground truth; `oracle` chooses among
//! selections by the clicked view. `volume` compares selections in space, `measure` in pictures; `result` holds the
//! results and their means, `table` writes them, and `run` performs all these steps in order.

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

pub use method::SelectionMethod;
pub use options::{SegmentEvalError, SegmentEvalOptions, SegmentOptionError, mask_source_names};
pub use result::{
    MethodMeans, SegmentEvaluation, SegmentResult, SelectionMeans, SelectionOutcome, TimeRow, VolumeScore,
};
pub use run::evaluate_segments;
pub use setting::TRIES;
pub use table::{KIND, markdown, write_results};
pub use target::TargetUnion;
pub use train::{LiftedField, TrainedMethods, write_mask_pictures};
