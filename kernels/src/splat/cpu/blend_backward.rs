//! Gradients of blending with respect to the projected Gaussians.
//!
//! Each tile is replayed front to back. With V the gradient of a pixel, `S` starts as `V . C` (the whole pixel) and
//! loses the contribution of each Gaussian in turn, which leaves the part behind it; then
//! `dL/dalpha = T (V . c) - S / (1 - alpha)`. Sums over a tile are kept in lanes and reduced once per tile and
//! Gaussian; per-Gaussian sums are then merged in the order of the tiles.

use super::bin::DrawnGaussian;
use super::blend::{Plane, TileArea, each};
use super::lanes::any;
use super::project::Splat2d;
use super::rows::{CENTRES, RowTerms};
use super::rule::Rule;
use super::{ForwardState, TILE};
use crate::backend::filled;
use crate::splat::{ALPHA_MAX, SplatSettings};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

/// Sums over pixels for one Gaussian: u, u dx, u dy, u dx^2, u dx dy, u dy^2 with u = dL/dpower, and dL/dcolour.
pub(super) type ScreenGradient = [f32; 9];

/// Returns the gradients on screen, by rank.
pub(super) fn blend_backward(
    saved: &ForwardState,
    grad_image: &[f32],
    settings: &SplatSettings,
) -> Vec<ScreenGradient> {
    let (width, height) = (settings.camera.width, settings.camera.height);
    let tiles_x = saved.bins.tiles_x;
    let arch = crate::arch();
    let partial: Vec<Vec<ScreenGradient>> = (0..saved.bins.tile_count())
        .into_par_iter()
        .map(|t| {
            let entries = saved.bins.tile(t);
            let area = TileArea::new(t, tiles_x, width, height);
            let mut sums = vec![[0.0; 9]; entries.len()];
            if !entries.is_empty() {
                let mut pixels = PixelGradients::load(&area, width, grad_image, &saved.image);
                let splats = &saved.order.splats;
                arch.dispatch(BlendBackwardTile { splats, entries, area, pixels: &mut pixels, sums: &mut sums });
            }
            sums
        })
        .collect();
    merge(saved, &partial)
}

/// Adds the tiles' sums per Gaussian. Each task owns a range of Gaussians and walks all tiles in order,
/// so the order of additions does not depend on the number of tasks.
fn merge(saved: &ForwardState, partial: &[Vec<ScreenGradient>]) -> Vec<ScreenGradient> {
    let n = saved.order.splats.len();
    let mut sums = filled([0.0; 9], n);
    let range = n.div_ceil(rayon::current_num_threads()).max(1);
    sums.par_chunks_mut(range).enumerate().for_each(|(k, out)| {
        let start = (k * range) as u32;
        for (t, sums) in partial.iter().enumerate() {
            for (drawn, sum) in saved.bins.tile(t).iter().zip(sums) {
                let Some(target) = drawn.rank.checked_sub(start).and_then(|j| out.get_mut(j as usize)) else {
                    continue;
                };
                for (a, b) in target.iter_mut().zip(sum) {
                    *a += b;
                }
            }
        }
    });
    sums
}

/// Per-pixel inputs of a tile.
struct PixelGradients {
    /// dL/d(red, green, blue, alpha).
    v: [Plane; 4],
    /// `V . C` of the part not replayed yet.
    behind: Plane,
}

impl PixelGradients {
    fn load(area: &TileArea, width: usize, grad: &[f32], image: &[f32]) -> Box<Self> {
        let mut out = Box::new(Self { v: [Plane::ZERO; 4], behind: Plane::ZERO });
        for r in 0..area.rows {
            for c in 0..area.columns {
                let at = ((area.y0 + r) * width + area.x0 + c) * 4;
                let p = r * TILE + c;
                let mut total = 0.0;
                for k in 0..4 {
                    out.v[k].0[p] = grad[at + k];
                    total += grad[at + k] * image[at + k];
                }
                out.behind.0[p] = total;
            }
        }
        out
    }
}

struct BlendBackwardTile<'a> {
    splats: &'a [Splat2d],
    entries: &'a [DrawnGaussian],
    area: TileArea,
    pixels: &'a mut PixelGradients,
    sums: &'a mut [ScreenGradient],
}

impl WithSimd for BlendBackwardTile<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { splats, entries, area, pixels, sums } = self;
        let vectors = TILE / S::F32_LANES;
        // as in blending: negative once a pixel is finished
        let mut left = area.transmittance();
        let open = S::as_mut_simd_f32s(&mut left.0).0;
        let behind = S::as_mut_simd_f32s(&mut pixels.behind.0).0;
        let [v0, v1, v2, v3] = &pixels.v;
        let v = [v0, v1, v2, v3].map(|plane| S::as_simd_f32s(&plane.0).0);
        let centres = S::as_simd_f32s(&CENTRES.0).0;
        let rule = Rule::new(simd);
        let alpha_max = simd.splat_f32s(ALPHA_MAX);
        let zero = simd.splat_f32s(0.0);
        let one = simd.splat_f32s(1.0);
        let mut terms = RowTerms::default();

        each(
            splats,
            entries,
            |drawn| drawn.rank,
            |n, drawn, s| {
                terms.set(simd, s, &area);
                let mut rows = drawn.rows;
                let offset = simd.splat_f32s(area.x0 as f32 - s.x);
                let qa = simd.splat_f32s(s.qa);
                let colour = s.colour.map(|c| simd.splat_f32s(c));
                let mut sum = [zero; 9];
                while rows != 0 {
                    let row = rows.trailing_zeros() as usize % TILE;
                    rows &= rows - 1;
                    let (qb, constant) = (simd.splat_f32s(terms.qb.0[row]), simd.splat_f32s(terms.constant.0[row]));
                    let dy = simd.splat_f32s(terms.dy.0[row]);
                    for column in 0..vectors {
                        let at = row * vectors + column;
                        let dx = simd.add_f32s(centres[column], offset);
                        let power = rule.power(simd, dx, [qa, qb, constant]);
                        let t = open[at];
                        let touched = rule.touched(simd, power, t);
                        if vectors > 1 && !any(simd, touched) {
                            continue;
                        }
                        let effect = rule.evaluate(simd, power, t, touched);
                        let weight = effect.weight;
                        // V . (c, 1): the fourth channel is alpha, to which every Gaussian contributes its full weight
                        let vc = simd.mul_add_e_f32s(v[0][at], colour[0], v[3][at]);
                        let vc = simd.mul_add_e_f32s(v[1][at], colour[1], vc);
                        let vc = simd.mul_add_e_f32s(v[2][at], colour[2], vc);
                        let rest = simd.sub_f32s(behind[at], simd.mul_f32s(weight, vc));
                        behind[at] = rest;
                        let behind = simd.div_f32s(rest, simd.sub_f32s(one, effect.alpha));
                        let d_alpha = simd.sub_f32s(simd.mul_f32s(t, vc), behind);
                        // a clamped alpha has no gradient
                        let free = simd.less_than_or_equal_f32s(effect.unclamped, alpha_max);
                        let free = simd.and_m32s(effect.blended, free);
                        let u = simd.select_f32s(free, simd.mul_f32s(effect.alpha, d_alpha), zero);

                        let (ux, uy) = (simd.mul_f32s(u, dx), simd.mul_f32s(u, dy));
                        sum[0] = simd.add_f32s(sum[0], u);
                        sum[1] = simd.add_f32s(sum[1], ux);
                        sum[2] = simd.add_f32s(sum[2], uy);
                        sum[3] = simd.mul_add_e_f32s(ux, dx, sum[3]);
                        sum[4] = simd.mul_add_e_f32s(ux, dy, sum[4]);
                        sum[5] = simd.mul_add_e_f32s(uy, dy, sum[5]);
                        for channel in 0..3 {
                            sum[6 + channel] = simd.mul_add_e_f32s(weight, v[channel][at], sum[6 + channel]);
                        }
                        open[at] = rule.left(simd, t, &effect, touched);
                    }
                }
                for (o, lanes) in sums[n].iter_mut().zip(sum) {
                    *o = simd.reduce_sum_f32s(lanes);
                }
                true
            },
        );
    }
}
