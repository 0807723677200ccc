//! What a Gaussian is in each row of a tile: the terms of its power, and whether it reaches the row, with rows in SIMD
//! lanes.

use super::TILE;
use super::blend::TileArea;
use super::lanes::bits;
use super::project::Splat2d;
use crate::splat::ALPHA_MIN;
use pulp::Simd;

/// A number for each row of a tile, aligned for the widest vectors.
#[derive(Clone, Copy, Default)]
#[repr(align(64))]
pub(crate) struct PerRow(pub [f32; TILE]);

/// Centres of a tile's pixels, relative to its left or upper edge.
pub(crate) const CENTRES: PerRow = {
    let mut c = [0.0; TILE];
    let mut i = 0;
    while i < TILE {
        c[i] = i as f32 + 0.5;
        i += 1;
    }
    PerRow(c)
};

/// The terms of `log2` of alpha, `(qa dx + qb) dx + constant`, that are the same for all pixels of a row.
#[derive(Default)]
pub(crate) struct RowTerms {
    /// From the Gaussian to the row's pixel centres.
    pub dy: PerRow,
    /// `qb dy`
    pub qb: PerRow,
    /// `qc dy^2 + log2_opacity`
    pub constant: PerRow,
}

impl RowTerms {
    /// Computes the terms of a Gaussian in every row of a tile. Returns the bit mask of the rows within its extent in
    /// which it may reach alpha 1/255 somewhere between the outermost pixel centres: never too few, rarely too many.
    #[inline(always)]
    pub(crate) fn set<S: Simd>(&mut self, simd: S, s: &Splat2d, area: &TileArea) -> u32 {
        // relative error of the terms below, with room
        const SLACK: f32 = 2e-6;
        let splat = |v: f32| simd.splat_f32s(v);
        let (left, right) = (area.x0 as f32 + 0.5 - s.x, area.x0 as f32 + (TILE as f32 - 0.5) - s.x);
        let reach = left.abs().max(right.abs());
        let threshold = splat(ALPHA_MIN.log2() + SLACK * s.qa * reach * reach);
        let low = splat(s.y - s.extent[1] - 0.5 - area.y0 as f32);
        let high = splat(s.y + s.extent[1] - 0.5 - area.y0 as f32);
        // alpha is greatest at dx = -qb dy / (2 qa)
        let crest = splat(-0.5 / s.qa);
        let (qa, qb, qc, lo) = (splat(s.qa), splat(s.qb), splat(s.qc), splat(s.log2_opacity));
        let centres = S::as_simd_f32s(&CENTRES.0).0;
        let (dy_out, qb_out, constant_out) = (
            S::as_mut_simd_f32s(&mut self.dy.0).0,
            S::as_mut_simd_f32s(&mut self.qb.0).0,
            S::as_mut_simd_f32s(&mut self.constant.0).0,
        );
        let mut rows = 0;
        for v in 0..TILE / S::F32_LANES {
            let dy = simd.sub_f32s(simd.add_f32s(centres[v], splat(area.y0 as f32)), splat(s.y));
            let qb = simd.mul_f32s(qb, dy);
            let constant = simd.add_f32s(simd.mul_f32s(simd.mul_f32s(qc, dy), dy), lo);
            (dy_out[v], qb_out[v], constant_out[v]) = (dy, qb, constant);

            let dx = simd.min_f32s(simd.max_f32s(simd.mul_f32s(qb, crest), splat(left)), splat(right));
            let power = simd.mul_add_e_f32s(simd.mul_add_e_f32s(qa, dx, qb), dx, constant);
            let power = simd.mul_add_e_f32s(constant, splat(-SLACK), power);
            let index = simd.sub_f32s(centres[v], splat(0.5));
            // what cannot be compared is not ruled out
            let out = simd.less_than_f32s(power, threshold);
            let within =
                simd.and_m32s(simd.greater_than_or_equal_f32s(index, low), simd.less_than_or_equal_f32s(index, high));
            rows |= (bits(simd, within) & !bits(simd, out)) << (v * S::F32_LANES);
        }
        rows
    }
}
