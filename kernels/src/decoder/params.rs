//! The decoder's inputs, its parameters and the gradients of both as slices. No arithmetic.

/// The parameters, row-major: `F` inputs, `W` hidden units, `H` heads, `C` outputs; in f64 for the oracle.
#[derive(Clone, Copy, Debug)]
pub struct DecoderParams<'a, T = f32> {
    /// Trunk weights `[F, W]`.
    pub w0: &'a [T],
    /// Trunk bias `[W]`.
    pub b0: &'a [T],
    /// Head weights `[W, H * W]`; head `k` owns columns `k * W .. (k + 1) * W`.
    pub w1: &'a [T],
    /// Head biases `[H * W]`.
    pub b1: &'a [T],
    /// Output weights `[W, C]`; each head owns its columns.
    pub w2: &'a [T],
    /// Output bias `[C]`.
    pub b2: &'a [T],
}

/// The inputs `[N, F]` in two parts, side by side, so that nobody has to copy them into one: features, and numbers that
/// each row has of its own, if any.
#[derive(Clone, Copy, Debug)]
pub struct DecoderInputs<'a> {
    /// `[N, F - E]`
    pub features: &'a [f32],
    /// `[N, E]`
    pub own: &'a [f32],
}

/// Inputs in one part.
impl<'a> From<&'a [f32]> for DecoderInputs<'a> {
    fn from(features: &'a [f32]) -> Self {
        Self { features, own: &[] }
    }
}

impl DecoderInputs<'_> {
    /// N for `inputs` = F.
    pub(super) fn rows(&self, inputs: usize) -> usize {
        (self.features.len() + self.own.len()) / inputs
    }

    /// `[F - E, E]` for `inputs` = F; zeros without rows.
    pub(super) fn widths(&self, inputs: usize) -> [usize; 2] {
        let n = self.rows(inputs).max(1);
        [self.features.len() / n, self.own.len() / n]
    }

    /// The two parts of a row.
    #[inline(always)]
    pub(super) fn row(&self, i: usize, [features, own]: [usize; 2]) -> [&[f32]; 2] {
        [&self.features[i * features..][..features], &self.own[i * own..][..own]]
    }

    /// Copies a row to `to` `[F]`.
    #[inline(always)]
    pub(super) fn copy_row(&self, i: usize, widths: [usize; 2], to: &mut [f32]) {
        let [features, own] = self.row(i, widths);
        to[..widths[0]].copy_from_slice(features);
        to[widths[0]..].copy_from_slice(own);
    }
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
    /// Gradient of the features `[N, F - E]`.
    pub features: &'a mut [f32],
    /// Gradient of each row's own numbers `[N, E]`.
    pub own: &'a mut [f32],
}
