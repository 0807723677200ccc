//! A click: all that a method learns about what is wanted.

/// What a clicked pixel is made of. A method does not learn where it was placed, or by whom.
#[derive(Clone, Debug, PartialEq)]
pub struct Click {
    /// Indices of Gaussians and their weights, nearest first.
    pub under: Vec<(u32, f32)>,
}
