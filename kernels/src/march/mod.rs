//! Ray marching through an emitting and absorbing medium: the placement of the samples along rays, and their
//! compositing.
//!
//! A ray through samples of optical depths `d_1 .. d_n` (density times step length) and colours `c_1 .. c_n` sees
//!
//! ```text
//! C = sum_i w_i c_i + T_(n+1) background        w_i = T_i (1 - exp(-d_i))        T_i = exp(-(d_1 + .. + d_(i-1)))
//! ```
//!
//! (Max, "Optical models for direct volume rendering", IEEE TVCG 1995, equation 10, for a medium that is constant in
//! each step; the same as in NeRF). Regions known to be empty are skipped: rays have as many samples as they need,
//! [`sample()`] places them, and [`composite`] takes them one ray after the other. Samples of little weight need not
//! have a colour.
//!
//! Fast kernels in [`cpu`], oracle in [`mod@reference`].

pub mod cpu;
#[cfg(feature = "cube")]
pub(crate) mod cube;
mod ops;
mod rays;
pub mod reference;
mod sample;

#[cfg(test)]
mod tests;

pub use ops::{MarchBackwardOps, MarchOps, MarchTensors, composite};
pub use rays::RaySamples;
pub use sample::{Box3, Ray, Samples, sample};
