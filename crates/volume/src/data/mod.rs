//! Datasets of rendered images: cameras, camera paths, `transforms_*.json`, image sets, splits, visual hulls, ground
//! truth of segments, and the checks behind `volseggs inspect`. No tensors, no training.
//!
//! A built-in layout of dataset folders is a file here with its [`DatasetLayout`](dataset_layout::DatasetLayout), and a line
//! in [`LAYOUTS`]; a program adds its own by `volseggs::extend`.

pub mod calibration;
pub mod camera;
mod carve;
pub mod dataset;
pub mod dataset_layout;
pub mod error;
mod fit;
#[doc(hidden)]
pub mod fixture;
pub mod hull;
pub mod images;
pub mod inspect;
mod inspect_views;
pub mod layout;
mod lenient;
mod lens;
pub mod lineage;
pub mod normalisation;
pub mod paths;
pub mod png;
pub mod scan;
pub mod surroundings;
pub mod thin;
pub mod transforms;
pub mod truth;
pub mod truth_volume;

pub use calibration::Calibration;
pub use camera::Camera;
pub use dataset::{Dataset, Frame, OpenOptions, Split, SplitName};
pub use error::DataError;
pub use hull::{Aabb, VisualHull};
pub use images::ImageSet;
pub use normalisation::Normalisation;
pub use surroundings::Surroundings;
pub use transforms::Transforms;
pub use truth::Truth;
pub use truth_volume::TruthVolume;

use crate::registry::Registry;

/// All layouts of dataset folders. A folder has the first one that recognises it.
pub static LAYOUTS: Registry<dyn dataset_layout::DatasetLayout> =
    Registry::new("layout of datasets", &[("transforms", &transforms::TransformsLayout)]);
