//! Fast forward pass of the decoder over f32 slices, and the entry point of the backward pass. Work is split into
//! blocks that depend on the input alone and merged in a fixed order, so the bits do not depend on the number of
//! threads; they may differ between processor families, whose vector width and fused multiply-add differ. No tensor
//! library and no parameter storage here.
//!
//! Rows never mix in the forward pass: NaN in a row gives NaN in its whole output row, infinity or overflow may do so,
//! and all other rows are unaffected. In the backward pass such a row, unless skipped, corrupts the parameter
//! gradients, but no input gradient other than its own.

use super::kernel::dots;
use super::layers::{BLOCK, head, trunk};
use super::pack::{Aligned, Packed};
use super::params::{DecoderGrads, DecoderInputs, DecoderParams};
use super::shape::DecoderShape;
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

/// Rows per forward task.
const FORWARD_ROWS: usize = 10 * BLOCK;

/// Decodes `x` `[N, F]` into `out` `[N, C]`. With `h = relu(x W0 + b0)`, head `k` gives its columns of
/// `relu(h W1_k + b1_k) W2 + b2`. Rows of zeros share one result, so that many of them cost next to nothing.
///
/// # Panics
/// If a slice length does not fit `shape`, or `shape` has an extent of 0.
pub fn forward<'a>(shape: &DecoderShape, params: DecoderParams<'_>, x: impl Into<DecoderInputs<'a>>, out: &mut [f32]) {
    let x = x.into();
    check(shape, params, x, out.len());
    if out.is_empty() {
        return;
    }
    let packed = Packed::new(shape, params);
    out.par_chunks_mut(FORWARD_ROWS * shape.outputs()).enumerate().for_each(|(chunk, out)| {
        crate::arch().dispatch(ForwardRows { packed: &packed, x, first: chunk * FORWARD_ROWS, out });
    });
}

/// Computes the gradients of [`forward`] for `grad_out` `[N, C]`. Hidden units are recomputed; nothing is kept from the
/// forward pass. A row whose `active` entry is false, or whose output gradient is all zeros, is skipped: its input
/// gradient is 0 and its values, even NaN, reach no other gradient. A hidden unit at exactly 0 passes no gradient.
///
/// # Panics
/// If a slice length does not fit `shape`, or `shape` has an extent of 0.
pub fn backward<'a>(
    shape: &DecoderShape,
    params: DecoderParams<'_>,
    x: impl Into<DecoderInputs<'a>>,
    grad_out: &[f32],
    active: Option<&[bool]>,
    grads: DecoderGrads<'_>,
) {
    let x = x.into();
    check(shape, params, x, grad_out.len());
    assert_eq!(grads.w0.len(), params.w0.len(), "grads.w0");
    assert_eq!(grads.b0.len(), params.b0.len(), "grads.b0");
    assert_eq!(grads.w1.len(), params.w1.len(), "grads.w1");
    assert_eq!(grads.b1.len(), params.b1.len(), "grads.b1");
    assert_eq!(grads.w2.len(), params.w2.len(), "grads.w2");
    assert_eq!(grads.b2.len(), params.b2.len(), "grads.b2");
    assert_eq!(grads.features.len(), x.features.len(), "grads.features");
    assert_eq!(grads.own.len(), x.own.len(), "grads.own");
    if let Some(active) = active {
        assert_eq!(active.len(), x.rows(shape.inputs), "active: one entry a row");
    }
    super::backward::run(shape, params, x, grad_out, active, grads);
}

fn check(shape: &DecoderShape, params: DecoderParams<'_>, x: DecoderInputs<'_>, outputs: usize) {
    if let Err(error) = shape.validate() {
        panic!("{error}");
    }
    assert_eq!(params.w0.len(), shape.w0_len(), "w0: [F, W]");
    assert_eq!(params.b0.len(), shape.b0_len(), "b0: [W]");
    assert_eq!(params.w1.len(), shape.w1_len(), "w1: [W, H * W]");
    assert_eq!(params.b1.len(), shape.b1_len(), "b1: [H * W]");
    assert_eq!(params.w2.len(), shape.w2_len(), "w2: [W, C]");
    assert_eq!(params.b2.len(), shape.b2_len(), "b2: [C]");
    let n = x.rows(shape.inputs);
    assert_eq!(x.features.len() + x.own.len(), n * shape.inputs, "features and own: [N, F]");
    assert!(x.own.len().is_multiple_of(n.max(1)), "own: [N, E]");
    assert_eq!(outputs, n * shape.outputs(), "outputs: [N, C]");
}

struct ForwardRows<'a> {
    packed: &'a Packed<'a>,
    x: DecoderInputs<'a>,
    /// The row of `x` that the first row of `out` belongs to.
    first: usize,
    out: &'a mut [f32],
}

impl WithSimd for ForwardRows<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (packed, shape, width) = (self.packed, self.packed.shape, self.packed.width);
        let (f, c) = (shape.inputs, shape.outputs());
        let widths = self.x.widths(f);
        let mut hidden = Aligned::new(BLOCK * width);
        let mut units = Aligned::new(BLOCK * width);
        // non-zero rows, and the first all-zero row, whose result the other zero rows share
        let mut zeros = Vec::new();
        let mut used = Vec::with_capacity(self.out.len() / c);
        for i in 0..self.out.len() / c {
            let zero = self.x.row(self.first + i, widths).iter().all(|part| part.iter().all(|&v| v == 0.0));
            if zero {
                zeros.push(i);
            }
            if !zero || zeros.len() == 1 {
                used.push(i);
            }
        }
        let mut gathered = vec![0.0; BLOCK * f];
        let mut decoded = vec![0.0; BLOCK * c];
        for block in used.chunks(BLOCK) {
            let (first, rows) = (block[0], block.len());
            let together = widths[1] == 0 && rows == BLOCK && block[rows - 1] == first + rows - 1;
            let x = if together {
                &self.x.features[(self.first + first) * f..][..BLOCK * f]
            } else {
                for (to, &i) in gathered.chunks_exact_mut(f).zip(block) {
                    self.x.copy_row(self.first + i, widths, to);
                }
                &gathered[..]
            };
            trunk(simd, packed, rows, x, &mut hidden);
            for (k, (first, size)) in shape.head_columns().enumerate() {
                head(simd, packed, k, rows, &hidden, &mut units);
                let weights = &packed.outputs[first * width..][..size * width];
                dots(simd, (&units, width), weights, packed.output_bias, first, &mut decoded[..rows * c]);
            }
            for (row, &i) in decoded.chunks_exact(c).zip(block) {
                self.out[i * c..][..c].copy_from_slice(row);
            }
        }
        if let Some((&first, others)) = zeros.split_first() {
            for &i in others {
                self.out.copy_within(first * c..(first + 1) * c, i * c);
            }
        }
    }
}
