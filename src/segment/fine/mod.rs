//! Fine segmentation (the paper's affinity field network): masks of rendered views, lifted to a field of features in
//! which what belongs together points the same way.
//!
//! `network` is the field, `views` what it is trained on, `file` its place in a run, `train` the steps, and
//! `extract` makes segments of the trained field.

pub mod extract;
pub mod file;
pub mod network;
pub mod train;
pub mod views;

pub use network::AffinityField;
