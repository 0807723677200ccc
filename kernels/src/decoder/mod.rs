//! Decoder of the deformation field: a shared trunk and small heads, for every row of features.
//! Sizes live in [`shape`], the fast kernels in [`cpu`], the oracle in [`mod@reference`].

mod backward;
pub mod cpu;
#[cfg(feature = "cube")]
mod cube;
mod kernel;
mod layers;
mod ops;
mod pack;
pub mod params;
pub mod reference;
pub mod shape;

#[cfg(test)]
mod tests;

pub use cpu::{backward, forward};
pub use ops::{DecoderBackwardOps, DecoderOps, DecoderTensors, DecoderWeights, decoder};
pub use params::{DecoderGrads, DecoderInputs, DecoderParams};
pub use shape::{DecoderShape, DecoderShapeError};
