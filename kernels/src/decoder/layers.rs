//! The layers that both passes compute: blocks of rows through the trunk and through a head.

use super::kernel::{BiasRelu, RowBlock, TILE, product};
use super::pack::Packed;
use pulp::Simd;

/// Rows whose hidden units are held at once, a whole number of tiles: they fit the first-level cache.
pub(super) const BLOCK: usize = 8 * TILE;

/// Hidden units of the trunk, `[rows, width]`.
#[inline(always)]
pub(super) fn trunk<S: Simd>(simd: S, packed: &Packed<'_>, rows: usize, x: &[f32], out: &mut [f32]) {
    let f = packed.shape.inputs;
    let bias = BiasRelu::<S>(S::as_simd_f32s(packed.trunk_bias()).0);
    product(simd, rows, RowBlock::new(x, f), (f, &packed.trunk), out, bias);
}

/// Hidden units of head `k` from those of the trunk, `[rows, width]`.
#[inline(always)]
pub(super) fn head<S: Simd>(simd: S, packed: &Packed<'_>, k: usize, rows: usize, trunk: &[f32], out: &mut [f32]) {
    let (panels, bias) = packed.head(k);
    let bias = BiasRelu::<S>(S::as_simd_f32s(bias).0);
    let trunk = RowBlock::new(trunk, packed.width);
    product(simd, rows, trunk, (packed.shape.width, panels), out, bias);
}
