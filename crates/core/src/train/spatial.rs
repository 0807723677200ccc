//! Ordering of Gaussians along a space-filling curve, so that neighbours in space are neighbours in memory: lookups
//! into the field's planes, in order of depth or of position, then hit the cache.

use super::densify::RowSource;

/// Bits per axis; 21 would fill 63 of 64 bits, 10 suffice for cells of a thousandth of the scene.
const BITS: u32 = 10;

/// Returns the Gaussians in Morton order of their means `[N, 3]` over their bounding box. Ties keep their order, as do
/// non-finite means, which come last.
pub fn curve_order(means: &[f32]) -> Vec<RowSource> {
    let finite = |p: &[f32]| p.iter().all(|v| v.is_finite());
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for p in means.chunks_exact(3).filter(|p| finite(p)) {
        for k in 0..3 {
            (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k]));
        }
    }
    let cells = (1u32 << BITS) as f32;
    let scale: [f32; 3] = std::array::from_fn(|k| cells / (high[k] - low[k]).max(f32::MIN_POSITIVE));
    let code = |p: &[f32]| {
        if !finite(p) {
            return u32::MAX;
        }
        let cell = |k: usize| ((p[k] - low[k]) * scale[k]).min(cells - 1.0) as u32;
        spread(cell(0)) | spread(cell(1)) << 1 | spread(cell(2)) << 2
    };
    let mut order: Vec<(u32, usize)> = means.chunks_exact(3).map(code).zip(0..).collect();
    order.sort_unstable();
    order.into_iter().map(|(_, i)| RowSource::Keep(i)).collect()
}

/// Spreads the bits of `v`, two zeros after each.
fn spread(v: u32) -> u32 {
    (0..BITS).fold(0, |out, bit| out | (v >> bit & 1) << (3 * bit))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sources(means: &[f32]) -> Vec<usize> {
        curve_order(means).into_iter().map(RowSource::source).collect()
    }

    #[test]
    fn corners_of_a_cube_come_in_morton_order_and_ties_stay() {
        let corners: Vec<f32> = (0..8).rev().flat_map(|c| [c & 1, c >> 1 & 1, c >> 2].map(|b| b as f32)).collect();
        assert_eq!(sources(&corners), [7, 6, 5, 4, 3, 2, 1, 0]);
        assert_eq!(sources(&[1.0; 9]), [0, 1, 2]);
        assert_eq!(sources(&[f32::NAN, 0.0, 0.0, 5.0, 5.0, 5.0, 1.0, 1.0, f32::INFINITY]), [1, 0, 2]);
        assert!(sources(&[]).is_empty());
    }

    proptest! {
        #[test]
        fn it_is_a_permutation(means in proptest::collection::vec(proptest::num::f32::ANY, 0..60)) {
            let n = means.len() / 3;
            let mut all = sources(&means[..3 * n]);
            all.sort_unstable();
            prop_assert_eq!(all, (0..n).collect::<Vec<_>>());
        }
    }
}
