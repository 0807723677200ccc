//! Distance between a rendered image and its target, with separate weights for colours and alpha, and its gradient: one
//! pass over both images. Fast kernel in [`cpu`], oracle in [`mod@reference`].

pub mod cpu;
#[cfg(feature = "cube")]
mod cube;
mod ops;
pub mod reference;
mod target;

#[cfg(test)]
mod tests;

pub use cpu::photometric;
pub use ops::{Photometric, PhotometricForward, PhotometricOps, photometric_loss};
pub use target::{TargetOps, target};

/// How a difference is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Distance {
    /// Its absolute value, with slope 0 at 0.
    Absolute,
    /// Its square.
    Squared,
}
