//! Changes of Gaussians `[N, 11]`, as a decoder returns them, by attribute.
//!
//! Slices of the tensor would do the same, but in a backward pass each of them makes a gradient as large as the whole,
//! zero except in its columns, and these are then added up. Here the gradient is put together once.

mod ops;

pub use ops::{ChangeTensors, ChangesBackwardOps, ChangesOps, split_changes};

/// Columns of each attribute, in their order: mean, rotation, log-scale, opacity logit.
pub const WIDTHS: [usize; 4] = [3, 4, 3, 1];
/// Columns of all attributes.
pub const COLUMNS: usize = 11;
