//! InSituNet: a generator of pictures from when and from where to look.
//!
//! He et al., "InSituNet: Deep image synthesis for parameter space exploration of ensemble simulations", IEEE TVCG 26(1), 2020.
//! Residual blocks that double the side make a picture of a few numbers ([`generator`]); it is to have the features of the
//! true one in a VGG network, and to look true to a [`discriminator`]. Nothing in it stands for space.
//!
//! As published, but for this:
//!
//! - The published generator makes pictures of 256x256. VolSegGS enlarges it to 1024x1024 and does not say how: two more
//!   blocks of 64 channels here, and as many in the discriminator. Pictures are brought to the size of the images in
//!   evaluation, images to the size of the pictures in training.
//! - Inputs are the time, and the direction of view. There is no visual mapping, whose parameters the published networks take
//!   in as a third group.
//! - Features are those of VGG-16 after its second ReLU, not of VGG-19: the weights are those that LPIPS needs too. Without
//!   them (`insitunet.vgg`) pixels are compared, with a note.
//! - Power iteration goes one step for each step of training, where PyTorch goes one for each time a layer is used.
//! - An image with alpha is put over the background first.

pub mod discriminator;
pub mod generator;
pub mod layers;
mod method;
mod model;
pub mod resize;
pub mod spectral;
mod training;

#[cfg(test)]
mod tests;

pub use method::InSituNetMethod;
pub use model::{InSituNet, InSituNetSpec};
pub use training::InSituNetTraining;
