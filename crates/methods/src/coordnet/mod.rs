//! CoordNet: one network for all views and times, which maps the position of a pixel to its colour.
//!
//! Han and Wang, "CoordNet: Data generation and visualization generation for time-varying volumes via a
//! coordinate-based neural network", IEEE TVCG 29(12), 2023. Residual blocks of sines, see [`network`]. The network has
//! no representation of space, so views between the training views are interpolated in image space.
//!
//! As published, except that:
//!
//! - Time is a fifth input: the published code for views has none, and the VolSegGS paper, which compares with
//!   CoordNet, does not say how it was given. It is scaled to [-1, 1] like the others.
//! - The published data are views at whole degrees, 180 by 360, with each angle scaled by its last value; here angles
//!   are arbitrary, so the ends are 180 and 360 degrees. As in the original, the network does not know that 359 degrees
//!   are next to 0.
//! - An image with alpha is composited over the background first.
//! - As in the published code, the pixels of an epoch are drawn from each image and all are shuffled; here, however, a
//!   step may extend past the end of an epoch, whereas in the original the last step of each epoch is shorter.

mod method;
pub mod network;
mod settings;

#[cfg(test)]
mod tests;

pub use method::{CoordNet, CoordNetSpec};
pub use settings::CoordNetConfig;
