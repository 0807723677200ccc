//! Fine segmentation (the paper's affinity field network): masks of rendered views are lifted to a field of features in
//! which Gaussians that belong together point the same way.
//!
//! `network` defines the field, `views` its training data, `file` its file in a run, `train` the training steps, and
//! `extract` the segments of the trained field.

pub mod extract;
pub mod file;
pub mod network;
pub mod train;
pub mod views;

pub use network::AffinityField;
