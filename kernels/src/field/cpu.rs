//! Fast forward and backward passes of the feature field over f32 slices. Work is split into chunks and bands that
//! depend on the input sizes alone and merged in a fixed order, so the bits do not depend on the number of threads;
//! they may differ between processor families, whose vector width and fused multiply-add differ. No tensor library and
//! no parameter storage here.
//!
//! A coordinate outside the box is clamped to the border and gets gradient 0; so does one exactly on it.
//! A point with a NaN coordinate has features of 0 and gradients of 0, and costs next to nothing.

use super::params::{FieldGrads, FieldParams};
use super::sample::{FieldData, Lanes, Tap};
use super::shape::FieldShape;
use pulp::{Scalar, Simd, WithSimd};
use rayon::prelude::*;

/// Points per forward task.
const FORWARD_CHUNK: usize = 256;

/// Samples the field: `points` `[N, 3]` in [-1, 1], `time` in [0, 1] over the whole knot range,
/// `features` `[N, levels * R]`, level-major. Per channel and level (paper: T4, not summed over channels)
/// `(xy * z + xz * y + yz * x) * t`, with align-corners linear sampling.
///
/// # Panics
/// If a slice length does not fit `shape`, or `shape` has an extent of 0.
pub fn forward(shape: &FieldShape, params: FieldParams<'_>, points: &[f32], time: f32, features: &mut [f32]) {
    check(shape, params, points, features.len());
    let field = FieldData::new(shape, params, time);
    features.par_chunks_mut(FORWARD_CHUNK * shape.features_len()).zip(points.par_chunks(FORWARD_CHUNK * 3)).for_each(
        |(features, points)| {
            crate::arch().dispatch(ForwardChunk { field: &field, points, features });
        },
    );
}

/// Computes the gradients of [`forward`] for `grad_features` `[N, levels * R]`. A point whose `active` entry is false
/// counts as having a zero feature gradient and costs next to nothing.
///
/// # Panics
/// If a slice length does not fit `shape`, or `shape` has an extent of 0.
pub fn backward(
    shape: &FieldShape,
    params: FieldParams<'_>,
    points: &[f32],
    time: f32,
    grad_features: &[f32],
    active: Option<&[bool]>,
    grads: FieldGrads<'_>,
) {
    check(shape, params, points, grad_features.len());
    assert_eq!(grads.planes.len(), params.planes.len(), "grads.planes");
    assert_eq!(grads.lines.len(), params.lines.len(), "grads.lines");
    assert_eq!(grads.times.len(), params.times.len(), "grads.times");
    assert_eq!(grads.points.len(), points.len(), "grads.points");
    if let Some(active) = active {
        assert_eq!(active.len(), points.len() / 3, "active: one entry a point");
    }
    super::backward::run(shape, params, points, time, grad_features, active, grads);
}

fn check(shape: &FieldShape, params: FieldParams<'_>, points: &[f32], features: usize) {
    shape.check([params.planes.len(), params.lines.len(), params.times.len()]);
    assert!(points.len().is_multiple_of(3), "points: [N, 3]");
    assert_eq!(features, points.len() / 3 * shape.features_len(), "features: [N, levels * R]");
}

struct ForwardChunk<'a> {
    field: &'a FieldData<'a>,
    points: &'a [f32],
    features: &'a mut [f32],
}

impl WithSimd for ForwardChunk<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        if self.field.channels.is_multiple_of(S::F32_LANES) {
            self.run(simd);
        } else {
            self.run(Scalar::new());
        }
    }
}

impl ForwardChunk<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let (field, r) = (self.field, self.field.channels);
        let rows = self.features.chunks_exact_mut(r * field.levels.len());
        for (row, point) in rows.zip(self.points.chunks_exact(3)) {
            if point.iter().any(|v| v.is_nan()) {
                row.fill(0.0);
                continue;
            }
            let levels = field.levels.iter().zip(field.time.chunks_exact(r));
            for ((level, time), out) in levels.zip(row.chunks_exact_mut(r)) {
                let taps = &Tap::point(point, level.n);
                let xy = field.quad::<0, S>(simd, level, taps);
                let xz = field.quad::<1, S>(simd, level, taps);
                let yz = field.quad::<2, S>(simd, level, taps);
                let x = field.pair(simd, level, taps, 0);
                let y = field.pair(simd, level, taps, 1);
                let z = field.pair(simd, level, taps, 2);
                let time = S::as_simd_f32s(&time[..r]).0;
                let out = S::as_mut_simd_f32s(&mut out[..r]).0;
                for b in 0..r / S::F32_LANES {
                    let sum = xy.at(b).0 * z.at(b).0;
                    let sum = xz.at(b).0.mul_add(y.at(b).0, sum);
                    let sum = yz.at(b).0.mul_add(x.at(b).0, sum);
                    out[b] = (sum * Lanes::new(simd, time[b])).v;
                }
            }
        }
    }
}
