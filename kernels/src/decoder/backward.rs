//! Backward pass of the decoder: rows with a gradient are gathered, split into ranges by their count alone, and the
//! parameter gradients of the ranges are added in order. Lengths are not checked here.

use super::kernel::{Add, ClampGate, RowBlock, Store, add_rows, gate_all, outer, product};
use super::layers::{BLOCK, head, trunk};
use super::pack::{Aligned, Packed, Transposed};
use super::params::{DecoderGrads, DecoderInputs, DecoderParams};
use super::shape::DecoderShape;
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

/// Maximum number of ranges that sum parameter gradients separately.
const RANGES: usize = 16;

pub(super) fn run(
    shape: &DecoderShape,
    params: DecoderParams<'_>,
    x: DecoderInputs<'_>,
    grad_out: &[f32],
    active: Option<&[bool]>,
    grads: DecoderGrads<'_>,
) {
    let used: Vec<usize> = grad_out
        .par_chunks_exact(shape.outputs())
        .with_min_len(1024)
        .enumerate()
        .filter(|&(i, row)| active.is_none_or(|on| on[i]) && row.iter().any(|&g| g != 0.0))
        .map(|(i, _)| i)
        .collect();
    let packed = Packed::new(shape, params);
    let transposed = Transposed::new(&packed, params);

    let blocks = used.len().div_ceil(BLOCK);
    let count = blocks.clamp(1, RANGES);
    let mut ranges = Vec::with_capacity(count);
    let n = grad_out.len() / shape.outputs();
    let widths = x.widths(shape.inputs);
    let (mut features, mut own, mut row) = (grads.features, grads.own, 0);
    for r in 0..count {
        let cut = |r: usize| (r * blocks / count * BLOCK).min(used.len());
        let (first, last) = (cut(r), cut(r + 1));
        // Each range owns the input rows up to the first row of the next.
        let end = if r + 1 < count { used[last] } else { n };
        let (features_window, features_after) = features.split_at_mut((end - row) * widths[0]);
        let (own_window, own_after) = own.split_at_mut((end - row) * widths[1]);
        ranges.push(RowRange {
            packed: &packed,
            transposed: &transposed,
            x,
            widths,
            grad_out,
            used: &used[first..last],
            window_row: row,
            window: [features_window, own_window],
        });
        (features, own, row) = (features_after, own_after, end);
    }
    let sums: Vec<GradientSums> = ranges.into_par_iter().map(|range| crate::arch().dispatch(range)).collect();
    let mut sums = sums.into_iter();
    if let Some(mut total) = sums.next() {
        sums.for_each(|sum| total.add(&sum));
        total.write(&packed, grads.w0, grads.b0, grads.w1, grads.b1);
        total.write_outputs(&packed, grads.w2, grads.b2);
    }
}

/// Parameter gradients of one range, rows padded to `width`.
struct GradientSums {
    /// `[F, width]`.
    trunk: Aligned,
    /// `[H, W, width]`.
    heads: Aligned,
    /// `[1 + H, width]`.
    biases: Aligned,
    /// Transposed, `[C, width]`.
    outputs: Aligned,
    /// `[C]`.
    output_bias: Vec<f32>,
}

impl GradientSums {
    fn new(packed: &Packed<'_>) -> Self {
        Self {
            trunk: Aligned::new(packed.trunk.len()),
            heads: Aligned::new(packed.heads.len()),
            biases: Aligned::new(packed.biases.len()),
            outputs: Aligned::new(packed.outputs.len()),
            output_bias: vec![0.0; packed.output_bias.len()],
        }
    }

    fn add(&mut self, other: &Self) {
        let add = |to: &mut [f32], from: &[f32]| {
            to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
        };
        add(&mut self.trunk, &other.trunk);
        add(&mut self.heads, &other.heads);
        add(&mut self.biases, &other.biases);
        add(&mut self.outputs, &other.outputs);
        add(&mut self.output_bias, &other.output_bias);
    }

    fn write(&self, packed: &Packed<'_>, w0: &mut [f32], b0: &mut [f32], w1: &mut [f32], b1: &mut [f32]) {
        let (w, width, heads) = (packed.shape.width, packed.width, packed.shape.heads());
        for (out, row) in w0.chunks_exact_mut(w).zip(self.trunk.chunks_exact(width)) {
            out.copy_from_slice(&row[..w]);
        }
        for (at, row) in self.heads.chunks_exact(width).enumerate() {
            let (k, i) = (at / w, at % w);
            w1[(i * heads + k) * w..][..w].copy_from_slice(&row[..w]);
        }
        let layers = std::iter::once(b0).chain(b1.chunks_exact_mut(w));
        for (out, row) in layers.zip(self.biases.chunks_exact(width)) {
            out.copy_from_slice(&row[..w]);
        }
    }

    fn write_outputs(&self, packed: &Packed<'_>, w2: &mut [f32], b2: &mut [f32]) {
        let columns = b2.len();
        for (j, out) in w2.chunks_exact_mut(columns).enumerate() {
            for (c, out) in out.iter_mut().enumerate() {
                *out = self.outputs[c * packed.width + j];
            }
        }
        b2.copy_from_slice(&self.output_bias);
    }
}

/// One range of used rows and the window of input gradients that it owns.
struct RowRange<'a> {
    packed: &'a Packed<'a>,
    transposed: &'a Transposed,
    x: DecoderInputs<'a>,
    /// `[F - E, E]`
    widths: [usize; 2],
    grad_out: &'a [f32],
    used: &'a [usize],
    /// First input row of the window.
    window_row: usize,
    /// Of the features and of each row's own numbers.
    window: [&'a mut [f32]; 2],
}

/// One block of gathered rows with everything computed from them; `[BLOCK, ..]` each.
struct GatheredBlock {
    rows: usize,
    x: Aligned,
    grad: Aligned,
    hidden: Aligned,
    /// Hidden units of one head, then their gradient before the clamp.
    units: Aligned,
    grad_hidden: Aligned,
    grad_x: Aligned,
}

impl WithSimd for RowRange<'_> {
    type Output = GradientSums;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> GradientSums {
        let (packed, shape) = (self.packed, self.packed.shape);
        let (f, c) = (shape.inputs, shape.outputs());
        let mut block = GatheredBlock {
            rows: 0,
            x: Aligned::new(BLOCK * f),
            grad: Aligned::new(BLOCK * c),
            hidden: Aligned::new(BLOCK * packed.width),
            units: Aligned::new(BLOCK * packed.width),
            grad_hidden: Aligned::new(BLOCK * packed.width),
            grad_x: Aligned::new(BLOCK * self.transposed.inputs),
        };
        let mut sums = GradientSums::new(packed);
        let [features, own] = self.window;
        features.fill(0.0);
        own.fill(0.0);
        for used in self.used.chunks(BLOCK) {
            block.rows = used.len();
            let gathered = block.x.chunks_exact_mut(f);
            for ((x, grad), &i) in gathered.zip(block.grad.chunks_exact_mut(c)).zip(used) {
                self.x.copy_row(i, self.widths, x);
                grad.copy_from_slice(&self.grad_out[i * c..][..c]);
                for (sum, g) in sums.output_bias.iter_mut().zip(grad) {
                    *sum += *g;
                }
            }
            block.run(simd, packed, self.transposed, &mut sums);
            let computed = block.grad_x.chunks_exact(self.transposed.inputs);
            for (row, &i) in computed.zip(used) {
                let (i, [of_features, of_own]) = (i - self.window_row, self.widths);
                features[i * of_features..][..of_features].copy_from_slice(&row[..of_features]);
                own[i * of_own..][..of_own].copy_from_slice(&row[of_features..f]);
            }
        }
        sums
    }
}

impl GatheredBlock {
    #[inline(always)]
    fn run<S: Simd>(&mut self, simd: S, packed: &Packed<'_>, transposed: &Transposed, sums: &mut GradientSums) {
        let (rows, width, shape) = (self.rows, packed.width, packed.shape);
        let (f, w, c) = (shape.inputs, shape.width, shape.outputs());
        trunk(simd, packed, rows, &self.x, &mut self.hidden);
        self.grad_hidden.fill(0.0);
        for (k, (first, size)) in shape.head_columns().enumerate() {
            head(simd, packed, k, rows, &self.hidden, &mut self.units);
            let columns = first * width..(first + size) * width;
            let head_at = k * packed.head_len()..(k + 1) * packed.head_len();
            let grad = RowBlock { data: &self.grad, stride: c, first };
            let output_sums = &mut sums.outputs[columns.clone()];
            outer(simd, rows, (grad, size), (&self.units, width), output_sums);

            let panels = &transposed.outputs[columns];
            product(simd, rows, grad, (size, panels), &mut self.units, ClampGate);
            let bias_sums = &mut sums.biases[(1 + k) * width..][..width];
            add_rows(simd, rows, &self.units, bias_sums);
            let hidden = RowBlock::new(&self.hidden, width);
            let head_sums = &mut sums.heads[head_at.clone()];
            outer(simd, rows, (hidden, w), (&self.units, width), head_sums);

            let units = RowBlock::new(&self.units, width);
            let panels = &transposed.heads[head_at];
            product(simd, rows, units, (w, panels), &mut self.grad_hidden, Add);
        }
        gate_all(simd, &self.hidden, &mut self.grad_hidden);
        add_rows(simd, rows, &self.grad_hidden, &mut sums.biases[..width]);
        let x = RowBlock::new(&self.x, f);
        outer(simd, rows, (x, f), (&self.grad_hidden, width), &mut sums.trunk);
        let grad_hidden = RowBlock::new(&self.grad_hidden, width);
        product(simd, rows, grad_hidden, (w, &transposed.trunk), &mut self.grad_x, Store);
    }
}
