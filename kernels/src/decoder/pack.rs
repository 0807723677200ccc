//! Weights laid out for the kernels: split into column panels of two vectors and padded with zeros. Layout only: no
//! arithmetic and no threads.

use super::params::DecoderParams;
use super::shape::DecoderShape;
use pulp::{Simd, WithSimd};
use std::ops::{Deref, DerefMut};

/// Bytes of a cache line; vectors that straddle two lines load at half speed.
const LINE: usize = 64;

/// A zeroed buffer that starts at a cache line.
pub(super) struct Aligned {
    data: Vec<f32>,
    first: usize,
    len: usize,
}

impl Aligned {
    pub(super) fn new(len: usize) -> Self {
        let spare = LINE / size_of::<f32>();
        let data = vec![0.0; len + spare];
        // an offset beyond the spare room means that the alignment cannot be determined; this affects speed only
        let first = data.as_ptr().align_offset(LINE).min(spare);
        Self { data, first, len }
    }
}

impl Deref for Aligned {
    type Target = [f32];
    fn deref(&self) -> &[f32] {
        &self.data[self.first..self.first + self.len]
    }
}

impl DerefMut for Aligned {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.data[self.first..self.first + self.len]
    }
}

struct LaneCount;

impl WithSimd for LaneCount {
    type Output = usize;
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> usize {
        S::F32_LANES
    }
}

/// Columns of a panel: two vectors of this processor.
fn panel_columns() -> usize {
    2 * crate::arch().dispatch(LaneCount)
}

/// Weights as the forward pass reads them. A matrix `[K, N]` is stored as panels `[N / P, K, P]`, `P` columns each;
/// columns past the last are zero, so that hidden units there stay 0.
pub(super) struct Packed<'a> {
    pub(super) shape: &'a DecoderShape,
    /// Width of the hidden layers, rounded up to whole panels.
    pub(super) width: usize,
    /// `W0` as panels.
    pub(super) trunk: Aligned,
    /// `W1` of each head in turn as panels, [`Packed::head_len`] each.
    pub(super) heads: Aligned,
    /// `b0`, then `b1` of each head, padded `[1 + H, width]`.
    pub(super) biases: Aligned,
    /// `W2` transposed and padded, `[C, width]`.
    pub(super) outputs: Aligned,
    /// `b2`.
    pub(super) output_bias: &'a [f32],
}

/// The transposed weights, which propagate gradients back.
pub(super) struct Transposed {
    /// Inputs, rounded up to whole panels.
    pub(super) inputs: usize,
    /// `W0` transposed, as panels.
    pub(super) trunk: Aligned,
    /// `W1` of each head transposed, as panels, [`Packed::head_len`] each.
    pub(super) heads: Aligned,
    /// `W2` of each head transposed, `[columns of the head, W]`, as panels.
    pub(super) outputs: Aligned,
}

/// Fills the panels of the matrix `[depth, columns]` with elements `at(row, column)`.
fn fill(out: &mut [f32], depth: usize, columns: usize, at: impl Fn(usize, usize) -> f32) {
    let panel = panel_columns();
    for (p, panel_out) in out.chunks_exact_mut(depth * panel).enumerate() {
        let first = p * panel;
        let count = panel.min(columns - first);
        for (row, out) in panel_out.chunks_exact_mut(panel).enumerate() {
            for (j, out) in out[..count].iter_mut().enumerate() {
                *out = at(row, first + j);
            }
        }
    }
}

impl<'a> Packed<'a> {
    pub(super) fn new(shape: &'a DecoderShape, params: DecoderParams<'a>) -> Self {
        let (f, w, c, heads) = (shape.inputs, shape.width, shape.outputs(), shape.heads());
        let width = w.next_multiple_of(panel_columns());
        let mut packed = Self {
            shape,
            width,
            trunk: Aligned::new(f * width),
            heads: Aligned::new(heads * w * width),
            biases: Aligned::new((1 + heads) * width),
            outputs: Aligned::new(c * width),
            output_bias: params.b2,
        };
        fill(&mut packed.trunk, f, w, |i, j| params.w0[i * w + j]);
        for (k, out) in packed.heads.chunks_exact_mut(w * width).enumerate() {
            fill(out, w, w, |i, j| params.w1[(i * heads + k) * w + j]);
        }
        let biases = packed.biases.chunks_exact_mut(width);
        let layers = std::iter::once(params.b0).chain(params.b1.chunks_exact(w));
        for (out, bias) in biases.zip(layers) {
            out[..w].copy_from_slice(bias);
        }
        for (column, out) in packed.outputs.chunks_exact_mut(width).enumerate() {
            for (j, out) in out[..w].iter_mut().enumerate() {
                *out = params.w2[j * c + column];
            }
        }
        packed
    }

    /// Length of the panels of one head.
    pub(super) fn head_len(&self) -> usize {
        self.shape.width * self.width
    }

    /// Bias of the trunk.
    pub(super) fn trunk_bias(&self) -> &[f32] {
        &self.biases[..self.width]
    }

    /// Panels and bias of head `k`.
    pub(super) fn head(&self, k: usize) -> (&[f32], &[f32]) {
        let panels = &self.heads[k * self.head_len()..][..self.head_len()];
        (panels, &self.biases[(1 + k) * self.width..][..self.width])
    }
}

impl Transposed {
    pub(super) fn new(packed: &Packed<'_>, params: DecoderParams<'_>) -> Self {
        let (shape, width) = (packed.shape, packed.width);
        let (f, w, c, heads) = (shape.inputs, shape.width, shape.outputs(), shape.heads());
        let inputs = f.next_multiple_of(panel_columns());
        let mut transposed = Self {
            inputs,
            trunk: Aligned::new(w * inputs),
            heads: Aligned::new(heads * w * width),
            outputs: Aligned::new(c * width),
        };
        fill(&mut transposed.trunk, w, f, |i, j| params.w0[j * w + i]);
        for (k, out) in transposed.heads.chunks_exact_mut(w * width).enumerate() {
            fill(out, w, w, |i, j| params.w1[(j * heads + k) * w + i]);
        }
        for (first, size) in shape.head_columns() {
            let out = &mut transposed.outputs[first * width..][..size * width];
            fill(out, size, w, |i, j| params.w2[j * c + first + i]);
        }
        transposed
    }
}
