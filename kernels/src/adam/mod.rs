//! The Adam optimiser step on one flat parameter buffer.
//! Fast kernel in [`cpu`], oracle in [`mod@reference`].

pub mod cpu;
#[cfg(feature = "cube")]
mod cube;
mod ops;
pub mod reference;

#[cfg(test)]
mod tests;

pub use cpu::{AdamStep, LrPattern, NonFiniteGradient, adam_step};
pub use ops::{AdamOps, AdamOutput, AdamTensors, NonFinite, adam};
