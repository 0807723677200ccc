//! The decoder's parameters and their gradients as slices. No sizes and no arithmetic.

/// The parameters, row-major: `F` inputs, `W` hidden units, `H` heads, `C` outputs.
#[derive(Clone, Copy, Debug)]
pub struct DecoderParams<'a> {
    /// Trunk weights `[F, W]`.
    pub w0: &'a [f32],
    /// Trunk bias `[W]`.
    pub b0: &'a [f32],
    /// Head weights `[W, H * W]`; head `k` owns columns `k * W .. (k + 1) * W`.
    pub w1: &'a [f32],
    /// Head biases `[H * W]`.
    pub b1: &'a [f32],
    /// Output weights `[W, C]`; each head owns its columns.
    pub w2: &'a [f32],
    /// Output bias `[C]`.
    pub b2: &'a [f32],
}

/// Output buffers of [`backward`](super::cpu::backward); every element is overwritten.
#[derive(Debug)]
pub struct DecoderGrads<'a> {
    /// Gradient of the trunk weights `[F, W]`.
    pub w0: &'a mut [f32],
    /// Gradient of the trunk bias `[W]`.
    pub b0: &'a mut [f32],
    /// Gradient of the head weights `[W, H * W]`.
    pub w1: &'a mut [f32],
    /// Gradient of the head biases `[H * W]`.
    pub b1: &'a mut [f32],
    /// Gradient of the output weights `[W, C]`.
    pub w2: &'a mut [f32],
    /// Gradient of the output bias `[C]`.
    pub b2: &'a mut [f32],
    /// Gradient of the inputs `[N, F]`.
    pub x: &'a mut [f32],
}
