//! The field's parameters and their gradients as slices. No sizes and no arithmetic.

/// The three flat parameter buffers, laid out as [`FieldShape`](super::shape::FieldShape) describes; in f64 for the
/// oracle.
#[derive(Clone, Copy, Debug)]
pub struct FieldParams<'a, T = f32> {
    /// Plane tensors.
    pub planes: &'a [T],
    /// Line tensors.
    pub lines: &'a [T],
    /// Time tensors.
    pub times: &'a [T],
}

/// Output buffers of [`backward`](super::cpu::backward); every element is overwritten.
#[derive(Debug)]
pub struct FieldGrads<'a> {
    /// Gradient of the plane buffer.
    pub planes: &'a mut [f32],
    /// Gradient of the line buffer.
    pub lines: &'a mut [f32],
    /// Gradient of the time buffer.
    pub times: &'a mut [f32],
    /// Gradient of the normalised points `[N, 3]`.
    pub points: &'a mut [f32],
}
