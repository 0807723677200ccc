//! InSituNet: a generator of images from a time and a view direction.
//!
//! He et al., "InSituNet: Deep image synthesis for parameter space exploration of ensemble simulations", IEEE TVCG
//! 26(1), 2020. Residual blocks that double the side length make an image from a few numbers ([`generator`]). They are
//! trained so that the image matches the features of the real one in a VGG network and looks real to a
//! [`discriminator`]. The networks have no representation of space.
//!
//! As published, except that:
//!
//! - The published generator makes images of 256x256. The VolSegGS paper enlarges it to 1024x1024 and does not say how;
//!   here this adds two blocks of 64 channels, and as many to the discriminator. Generated images are resized to those
//!   of the dataset in evaluation, and the reverse in training.
//! - The inputs are the time and the view direction. There are no visual-mapping parameters, which are a third group of
//!   inputs of the published networks.
//! - Features are those of VGG-16 after its second ReLU, not of VGG-19: LPIPS needs the same weights. Without them
//!   (`insitunet.vgg`), pixels are compared and a note is printed.
//! - There is one step of power iteration per training step, whereas PyTorch does one each time a layer is used.
//! - An image with alpha is composited over the background first.

pub mod discriminator;
pub mod generator;
pub mod layers;
mod method;
mod model;
pub mod resize;
mod settings;
pub mod spectral;
mod training;

#[cfg(test)]
mod tests;

pub use method::InSituNetMethod;
pub use model::{InSituNet, InSituNetSpec};
pub use settings::{AdversarialLoss, InSituNetConfig};
pub use training::InSituNetTraining;
