//! Native 4D Gaussians (4DGS: Yang, Yang, Pan, Zhang: *Real-time Photorealistic Dynamic Scene Representation and
//! Rendering with 4D Gaussian Splatting*, ICLR 2024): Gaussians in space and time, drawn as they are at the time of an
//! image. They do not persist over time, so they have no segments or tracks. The primitives, in tensor operations:
//!
//! ```text
//! Gaussians4d  means and scales in x, y, z, t; two quaternions; opacity; colours over directions and time
//!   rotation   the quaternions -> a 4x4 rotation
//!   moment     4D Gaussians and a time -> 3D means, covariances, velocities and marginals
//!   harmonics  colours over directions and time, and a time -> spherical harmonics
//! ```
//!
//! [`Gaussians4d::at_time`] passes the result to [`volseggs_kernels::splat::splat_covariances`]: a 4D Gaussian at a
//! time has a covariance of its own, not a rotation with scales. They are trained like those of 3DGS: `first` places
//! them, `training` is their [`volseggs_core::train::Training`] with `rows` (added and removed Gaussians) and `rigid`
//! (neighbours move alike), `model` their [`volseggs_core::model::Model`] with its file, and `method` their
//! [`crate::Method`].

mod first;
mod gaussians;
mod harmonics;
mod method;
mod model;
mod moment;
#[cfg(test)]
mod official_tests;
#[cfg(test)]
mod reference;
mod rigid;
mod rotation;
mod rows;
mod settings;
#[cfg(test)]
mod tests;
mod training;
#[cfg(test)]
mod training_tests;

pub use gaussians::{ColourSeries, Gaussians4d};
pub use harmonics::harmonics_at;
pub use method::FourDgs;
pub(super) use method::NAME;
pub use moment::ConditionalGaussians;
pub use rotation::rotation_matrices;
pub use settings::FourDgsConfig;
