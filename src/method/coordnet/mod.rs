//! CoordNet: one network for all views and times, from where a pixel is to its colour.
//!
//! Han and Wang, "CoordNet: Data generation and visualization generation for time-varying volumes via a coordinate-based
//! neural network", IEEE TVCG 29(12), 2023. Residual blocks of sines, see [`network`]; nothing in it stands for space, so that
//! views between those it was trained on are interpolated in the image.
//!
//! As published, but for this:
//!
//! - Time is a fifth input: the published code for views has none, and VolSegGS, which compares with CoordNet, does not say
//!   how it was given. It is scaled to [-1, 1] like the others.
//! - The published data are views at whole degrees, 180 by 360, each angle scaled by its last value; angles are any here, so
//!   180 and 360 degrees are the ends. As there, nothing says that 359 degrees lie beside 0.
//! - An image with alpha is put over the background first.
//! - The published code draws the pixels of an epoch from each image and shuffles all; here, too, but a step may reach over the
//!   end of an epoch, where there the last step of each is shorter.

mod method;
pub mod network;

#[cfg(test)]
mod tests;

pub use method::{CoordNet, CoordNetSpec};
