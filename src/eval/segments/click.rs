//! A click: all that a method is told of what is wanted.

/// What a clicked pixel is made of. Where it was placed, and by whom, a method is not told.
#[derive(Clone, Debug, PartialEq)]
pub struct Click {
    /// Indices of Gaussians and their weights, nearest first.
    pub under: Vec<(u32, f32)>,
}
