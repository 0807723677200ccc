//! Register-blocked products of one block of rows with packed weights, on vectors of any processor. A block is
//! row-major and padded to whole tiles of rows; the contents of the padding rows are arbitrary but never mix with real
//! rows. No layers and no threads here.

use pulp::Simd;

/// Rows of a register tile: 6 rows of two vectors fill 12 of 16 registers with sums.
pub(super) const TILE: usize = 6;

/// How a sum is stored, given the previous output and the index of the vector within the output row.
pub(super) trait Finish<S: Simd>: Copy {
    fn finish(self, simd: S, old: S::f32s, sum: S::f32s, vector: usize) -> S::f32s;
}

/// Replaces the output.
#[derive(Clone, Copy)]
pub(super) struct Store;

impl<S: Simd> Finish<S> for Store {
    #[inline(always)]
    fn finish(self, _: S, _: S::f32s, sum: S::f32s, _: usize) -> S::f32s {
        sum
    }
}

/// Adds to the output.
#[derive(Clone, Copy)]
pub(super) struct Add;

impl<S: Simd> Finish<S> for Add {
    #[inline(always)]
    fn finish(self, simd: S, old: S::f32s, sum: S::f32s, _: usize) -> S::f32s {
        simd.add_f32s(old, sum)
    }
}

/// Adds the bias and clamps below at 0; NaN is kept.
#[derive(Clone, Copy)]
pub(super) struct BiasRelu<'a, S: Simd>(pub(super) &'a [S::f32s]);

impl<S: Simd> Finish<S> for BiasRelu<'_, S> {
    #[inline(always)]
    fn finish(self, simd: S, _: S::f32s, sum: S::f32s, vector: usize) -> S::f32s {
        let sum = simd.add_f32s(sum, self.0[vector]);
        gate(simd, sum, sum)
    }
}

/// Keeps the sum where the output was a live hidden unit, else 0: the gradient of the clamp.
#[derive(Clone, Copy)]
pub(super) struct ClampGate;

impl<S: Simd> Finish<S> for ClampGate {
    #[inline(always)]
    fn finish(self, simd: S, old: S::f32s, sum: S::f32s, _: usize) -> S::f32s {
        gate(simd, old, sum)
    }
}

/// `value` where `unit` is above 0 or NaN, else 0.
#[inline(always)]
pub(super) fn gate<S: Simd>(simd: S, unit: S::f32s, value: S::f32s) -> S::f32s {
    let zero = simd.splat_f32s(0.0);
    simd.select_f32s(simd.less_than_or_equal_f32s(unit, zero), zero, value)
}

/// A row-major block, viewed from its first used column.
#[derive(Clone, Copy)]
pub(super) struct RowBlock<'a> {
    pub(super) data: &'a [f32],
    /// Elements from one row to the next.
    pub(super) stride: usize,
    /// First column used.
    pub(super) first: usize,
}

impl<'a> RowBlock<'a> {
    pub(super) fn new(data: &'a [f32], stride: usize) -> Self {
        let first = 0;
        Self { data, stride, first }
    }
}

/// `out[i, :] = finish(out[i, :], a[i, ..depth] * B)` for `rows` rows rounded up to whole tiles, where
/// `panels` hold B `[depth, columns]` and `out` is `[.., columns]`.
#[inline(always)]
pub(super) fn product<S: Simd, F: Finish<S>>(
    simd: S,
    rows: usize,
    a: RowBlock<'_>,
    (depth, panels): (usize, &[f32]),
    out: &mut [f32],
    finish: F,
) {
    let out = S::as_mut_simd_f32s(out).0;
    let panels = S::as_simd_f32s(panels).0.as_chunks::<2>().0;
    let out_stride = panels.len() / depth * 2;
    for (p, panel) in panels.chunks_exact(depth).enumerate() {
        for i in (0..rows).step_by(TILE) {
            let row = |r: usize| &a.data[(i + r) * a.stride + a.first..][..panel.len()];
            let tile = [row(0), row(1), row(2), row(3), row(4), row(5)];
            let mut sums = [[simd.splat_f32s(0.0); 2]; TILE];
            for (k, &[left, right]) in panel.iter().enumerate() {
                for r in 0..TILE {
                    let factor = simd.splat_f32s(tile[r][k]);
                    sums[r][0] = simd.mul_add_e_f32s(factor, left, sums[r][0]);
                    sums[r][1] = simd.mul_add_e_f32s(factor, right, sums[r][1]);
                }
            }
            for r in 0..TILE {
                let out = &mut out[(i + r) * out_stride + 2 * p..][..2];
                out[0] = finish.finish(simd, out[0], sums[r][0], 2 * p);
                out[1] = finish.finish(simd, out[1], sums[r][1], 2 * p + 1);
            }
        }
    }
}

/// `out[p, :] += sum_i a[i, p] * b[i, :]` over exactly `rows` rows and `count` columns of `a`; `b` and
/// `out` have rows of `columns`, a whole number of panels.
#[inline(always)]
pub(super) fn outer<S: Simd>(
    simd: S,
    rows: usize,
    (a, count): (RowBlock<'_>, usize),
    (b, columns): (&[f32], usize),
    out: &mut [f32],
) {
    let stride = columns / S::F32_LANES;
    let b = &S::as_simd_f32s(b).0[..rows * stride];
    let out = S::as_mut_simd_f32s(out).0;
    let a_rows = &a.data[..rows * a.stride];
    for p in (0..count).step_by(TILE) {
        let first = a.first + p;
        let out = &mut out[p * stride..];
        for q in (0..stride).step_by(2) {
            let at = (first, a.stride, q, stride);
            match count - p {
                1 => outer_tile::<S, 1>(simd, a_rows, b, at, out),
                2 => outer_tile::<S, 2>(simd, a_rows, b, at, out),
                3 => outer_tile::<S, 3>(simd, a_rows, b, at, out),
                4 => outer_tile::<S, 4>(simd, a_rows, b, at, out),
                5 => outer_tile::<S, 5>(simd, a_rows, b, at, out),
                _ => outer_tile::<S, TILE>(simd, a_rows, b, at, out),
            }
        }
    }
}

#[inline(always)]
fn outer_tile<S: Simd, const R: usize>(
    simd: S,
    a: &[f32],
    b: &[S::f32s],
    (first, a_stride, q, stride): (usize, usize, usize, usize),
    out: &mut [S::f32s],
) {
    let mut sums = [[simd.splat_f32s(0.0); 2]; R];
    for r in 0..R {
        sums[r].copy_from_slice(&out[r * stride + q..][..2]);
    }
    for (a, b) in a.chunks_exact(a_stride).zip(b.chunks_exact(stride)) {
        let (a, b) = (&a[first..first + R], &b[q..q + 2]);
        for r in 0..R {
            let factor = simd.splat_f32s(a[r]);
            sums[r][0] = simd.mul_add_e_f32s(factor, b[0], sums[r][0]);
            sums[r][1] = simd.mul_add_e_f32s(factor, b[1], sums[r][1]);
        }
    }
    for r in 0..R {
        out[r * stride + q..][..2].copy_from_slice(&sums[r]);
    }
}

/// `out[i, first + c] = a[i, :] . weights[c, :] + bias[first + c]` for exactly the rows of `out` `[rows, C]`
/// (`C` is the length of `bias`); `a` has whole tiles of rows of `columns`.
#[inline(always)]
pub(super) fn dots<S: Simd>(
    simd: S,
    (a, columns): (&[f32], usize),
    weights: &[f32],
    bias: &[f32],
    first: usize,
    out: &mut [f32],
) {
    let stride = columns / S::F32_LANES;
    let a = S::as_simd_f32s(a).0;
    let weights = S::as_simd_f32s(weights).0;
    let tiles = a.chunks_exact(TILE * stride);
    for (tile, out) in tiles.zip(out.chunks_mut(TILE * bias.len())) {
        let row = |r: usize| &tile[r * stride..][..stride];
        let rows = [row(0), row(1), row(2), row(3), row(4), row(5)];
        for (column, weights) in (first..).zip(weights.chunks_exact(stride)) {
            let mut sums = [simd.splat_f32s(0.0); TILE];
            for v in 0..stride {
                for r in 0..TILE {
                    sums[r] = simd.mul_add_e_f32s(rows[r][v], weights[v], sums[r]);
                }
            }
            for (out, &sum) in out.chunks_exact_mut(bias.len()).zip(&sums) {
                out[column] = simd.reduce_sum_f32s(sum) + bias[column];
            }
        }
    }
}

/// `out[:] += sum_i a[i, :]` over exactly `rows` rows, each as long as `out`.
#[inline(always)]
pub(super) fn add_rows<S: Simd>(simd: S, rows: usize, a: &[f32], out: &mut [f32]) {
    let out = S::as_mut_simd_f32s(out).0;
    let a = S::as_simd_f32s(a).0;
    for row in a.chunks_exact(out.len()).take(rows) {
        for (out, &a) in out.iter_mut().zip(row) {
            *out = simd.add_f32s(*out, a);
        }
    }
}

/// Sets `values` to 0 where `units` is a dead hidden unit.
#[inline(always)]
pub(super) fn gate_all<S: Simd>(simd: S, units: &[f32], values: &mut [f32]) {
    let values = S::as_mut_simd_f32s(values).0;
    for (value, &unit) in values.iter_mut().zip(S::as_simd_f32s(units).0) {
        *value = gate(simd, unit, *value);
    }
}
