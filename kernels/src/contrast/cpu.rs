//! Computes the loss from sums over masks, or pair by pair in vectors of pixels. Tasks are fixed ranges of pixels and
//! their sums are added in order, so the bits do not depend on the number of threads.

use super::FEATURES;
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

/// Lanes of the widest vectors.
const MAX_LANES: usize = 16;
/// Pixels per task.
const PIECE: usize = 64;

/// Computes loss and gradient from sums over masks; with `apart`, pixels of different masks count by their cosine,
/// otherwise not at all.
pub(super) fn by_sums(units: &[f32], masks: &[u32], apart: bool) -> (f64, Vec<f32>) {
    let count = masks.iter().max().map_or(0, |m| *m as usize + 1);
    let mut sums = vec![[0.0f64; FEATURES]; count];
    let mut sizes = vec![0.0f64; count];
    for (unit, &m) in units.chunks_exact(FEATURES).zip(masks) {
        sizes[m as usize] += 1.0;
        sums[m as usize].iter_mut().zip(unit).for_each(|(s, u)| *s += f64::from(*u));
    }
    let mut total = [0.0f64; FEATURES];
    sums.iter().for_each(|s| total.iter_mut().zip(s).for_each(|(t, s)| *t += s));
    // the cosines of all pairs add up to |total|^2, those of pairs within masks to the sum of |sums|^2
    let (all, share) = if apart { (1.0, 2.0) } else { (0.0, 1.0) };
    let square = |v: &[f64; FEATURES]| v.iter().map(|v| v * v).sum::<f64>();
    let pairs = (masks.len() as f64).powi(2).max(1.0);
    let within: f64 = sums.iter().map(square).sum();
    let loss = (sizes.iter().map(|n| n * n).sum::<f64>() + all * square(&total) - share * within) / pairs;
    let slopes: Vec<[f32; FEATURES]> =
        sums.iter().map(|s| std::array::from_fn(|k| (2.0 * (all * total[k] - share * s[k]) / pairs) as f32)).collect();
    (loss, masks.iter().flat_map(|&m| slopes[m as usize]).collect())
}

/// Computes loss and gradient over all pairs: one pixel with a vector of others at a time, features stored as columns.
pub(super) fn by_pairs(units: &[f32], masks: &[u32], margin: f32) -> (f64, Vec<f32>) {
    let count = masks.len();
    let padded = count.next_multiple_of(MAX_LANES);
    let mut columns = vec![0.0f32; FEATURES * padded];
    for (j, unit) in units.chunks_exact(FEATURES).enumerate() {
        for (k, &u) in unit.iter().enumerate() {
            columns[k * padded + j] = u;
        }
    }
    // f32 represents every possible mask number exactly; a padded pixel belongs to no mask
    let mut others = vec![-1.0f32; padded];
    others.iter_mut().zip(masks).for_each(|(o, m)| *o = *m as f32);
    let pairs = (count as f64).powi(2).max(1.0);
    let arch = crate::arch();
    let mut gradient = vec![0.0f32; units.len()];
    let losses: Vec<f64> = gradient
        .par_chunks_mut(PIECE * FEATURES)
        .zip(units.par_chunks(PIECE * FEATURES))
        .zip(masks.par_chunks(PIECE))
        .map(|((gradient, units), masks)| {
            arch.dispatch(Pairs { units, masks, margin, columns: &columns, others: &others, gradient })
        })
        .collect();
    // a padded pixel has cosine 0 with every pixel, and counts if the margin is negative
    let padding = (padded - count) as f64 * f64::from((0.0 - margin).max(0.0)) * count as f64;
    // every pair occurs in both orders, hence the factor 2
    gradient.par_iter_mut().with_min_len(1 << 14).for_each(|v| *v = (2.0 * f64::from(*v) / pairs) as f32);
    ((losses.iter().sum::<f64>() - padding) / pairs, gradient)
}

/// A range of pixels, paired with all pixels.
struct Pairs<'a> {
    units: &'a [f32],
    masks: &'a [u32],
    margin: f32,
    /// `[16, P]`, padded.
    columns: &'a [f32],
    others: &'a [f32],
    /// Half the sum of the slopes over the pairs.
    gradient: &'a mut [f32],
}

impl WithSimd for Pairs<'_> {
    /// Sum of the losses of the pairs.
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let padded = self.others.len();
        let others = S::as_simd_f32s(self.others).0;
        let columns: [&[S::f32s]; FEATURES] =
            std::array::from_fn(|k| &S::as_simd_f32s(&self.columns[k * padded..][..padded]).0[..others.len()]);
        let (zero, one, minus) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0), simd.splat_f32s(-1.0));
        let margin = simd.splat_f32s(self.margin);
        let mut total = 0.0;
        let rows = self.gradient.chunks_exact_mut(FEATURES).zip(self.units.chunks_exact(FEATURES)).zip(self.masks);
        for ((out, unit), &mask) in rows {
            let unit: [S::f32s; FEATURES] = std::array::from_fn(|k| simd.splat_f32s(unit[k]));
            let mask = simd.splat_f32s(mask as f32);
            let (mut slopes, mut loss) = ([zero; FEATURES], zero);
            for v in 0..others.len() {
                let (mut even, mut odd) = (zero, zero);
                for k in (0..FEATURES).step_by(2) {
                    even = simd.mul_add_e_f32s(unit[k], columns[k][v], even);
                    odd = simd.mul_add_e_f32s(unit[k + 1], columns[k + 1][v], odd);
                }
                let cosine = simd.add_f32s(even, odd);
                let over = simd.sub_f32s(cosine, margin);
                let same = simd.equal_f32s(others[v], mask);
                let apart = simd.less_than_f32s(zero, over);
                let repelled = simd.select_f32s(apart, over, zero);
                // NaN is neither above nor below the margin, and must be propagated
                let repelled = simd.select_f32s(simd.equal_f32s(over, over), repelled, over);
                loss = simd.add_f32s(loss, simd.select_f32s(same, simd.sub_f32s(one, cosine), repelled));
                let weight = simd.select_f32s(same, minus, simd.select_f32s(apart, one, zero));
                for k in 0..FEATURES {
                    slopes[k] = simd.mul_add_e_f32s(weight, columns[k][v], slopes[k]);
                }
            }
            total += f64::from(simd.reduce_sum_f32s(loss));
            for (out, lanes) in out.iter_mut().zip(slopes) {
                *out = simd.reduce_sum_f32s(lanes);
            }
        }
        total
    }
}
