//! The trained model: burn modules for the Gaussians and their deformation over time.
//!
//! Depends on the kernels and the configuration's types; knows nothing of images, losses or dataset files.

pub mod appearance;
pub mod at;
pub mod camera;
pub mod d3dgs;
pub mod decoder;
pub mod defined_encoder;
pub mod deformation;
pub mod drawing;
pub mod embedding;
pub mod encoder;
pub mod encoder_definition;
#[doc(hidden)]
pub mod fixture;
pub mod gaussians;
pub mod host;
mod packed;
pub mod params;
pub mod pictures;
pub mod rendering;
pub mod scene;
pub mod scene_file;
pub mod sh;
pub mod size;
pub mod time_curve;

pub use at::OtherTimes;
pub use camera::ToKernel;
pub use deformation::DeformationField;
pub use drawing::{Counts, Model};
pub use gaussians::Gaussians;
pub use host::HostGaussians;
pub use rendering::Rendering;
pub use scene::{Scene, SceneSpec};
pub use scene_file::SceneError;
