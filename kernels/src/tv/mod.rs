//! Smoothness and one-prior penalties on the feature field's parameters (paper eq. 6).
//! Fast kernel in [`cpu`], oracle in [`mod@reference`].

pub mod cpu;
#[cfg(feature = "cube")]
mod cube;
mod ops;
pub mod reference;

#[cfg(test)]
mod tests;

pub use cpu::{TvGrads, TvKind, TvReduction, TvWeights, tv};
pub use ops::{TvForward, TvOps, total_variation};
