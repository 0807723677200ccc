//! Opacities that follow the length of a ray's path through a Gaussian, as those of a body of constant density do: a
//! flat one is denser from its edge than from its face. In 3DGS they are the same from all sides.
//!
//! Along a ray through its centre, a Gaussian with standard deviations `s` has one of `L = 1 / |S^-1 R^T d|`, where `d`
//! is the direction from the eye. With the geometric mean `s0` of its standard deviations and an `exponent` p,
//!
//! ```text
//! opacity = 1 - exp(-depth),    depth = -ln(1 - base opacity) * (L / s0)^p
//! ```
//!
//! so that p = 0 is 3DGS, p = 1 a body whose optical depth is the integral of its density along the ray, as in volume
//! rendering (Talegaonkar et al., *Volumetrically Consistent 3D Gaussian Rasterization*, CVPR 2025, who also shape the
//! footprint by it; here the footprint of 3DGS stays), and a Gaussian with three equal axes is the same for any p. The
//! result is a logit again: [`crate::splat::splat`] and the lists of contributors take it in place of the base logit.

pub mod cpu;
#[cfg(feature = "cube")]
mod cube;
mod ops;
pub mod reference;

pub use ops::{PathBackwardOps, PathOps, PathTensors, path_opacity};

/// Largest exponent allowed.
pub const MAX_EXPONENT: f32 = 1.0;
/// Largest difference of a log scale from their mean that counts: a factor of 22,000 between axes.
pub(crate) const REACH: f32 = 10.0;
/// Lower bound for the squared distance from the eye.
pub(crate) const MIN_SQUARE: f32 = 1e-20;
/// A logarithm of the optical depth below which it is the logit.
pub(crate) const SMALL: f32 = -12.0;
