//! Smoothness and one-prior penalties on the feature field's parameters (paper eq. 6).
//! Fast kernel in [`cpu`], oracle in [`mod@reference`].

pub mod cpu;
#[cfg(feature = "cube")]
mod cube;
mod ops;
pub mod reference;

#[cfg(test)]
mod tests;

pub use cpu::{DifferenceReduction, TvGrads, TvKind, TvWeights, tv};
pub use ops::{TvForward, TvOps, total_variation};
