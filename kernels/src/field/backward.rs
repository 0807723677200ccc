//! The backward pass of the feature field: plane gradients by bands of rows, the rest by chunks of points.
//! Tasks depend on the input sizes alone; entry point and argument checks are in [`super::cpu`].

use super::params::{FieldGrads, FieldParams};
use super::sample::{FieldData, Lanes, Tap};
use super::shape::{FieldShape, PLANE_AXES, PLANE_LINE};
use pulp::{Scalar, Simd, WithSimd};
use rayon::prelude::*;

/// Maximum number of tasks that hold private line gradients in the backward pass; bounds their memory.
const BACKWARD_CHUNKS: usize = 32;
/// Minimum number of points that justifies a private line-gradient buffer.
const BACKWARD_CHUNK_MIN: usize = 512;
/// Points whose feature gradients are gathered at once, so that their cache misses overlap.
const GATHER: usize = 32;
/// Plane rows whose gradient one task owns; 8 rows of 128 nodes of 32 channels fit a core's own cache.
const BAND_ROWS: usize = 8;

/// Overwrites `grads`; the arguments must already have been checked.
pub(super) fn run(
    shape: &FieldShape,
    params: FieldParams<'_>,
    points: &[f32],
    time: f32,
    grad_features: &[f32],
    active: Option<&[bool]>,
    grads: FieldGrads<'_>,
) {
    let input = Backward { field: FieldData::new(shape, params, time), points, grad: grad_features, active };
    let FieldGrads { planes, lines, times, points: grad_points } = grads;
    rayon::join(|| input.scatter_planes(shape, planes), || input.walk_points(shape, time, lines, times, grad_points));
}

/// Data read by every backward task.
struct Backward<'a> {
    field: FieldData<'a>,
    points: &'a [f32],
    /// Feature gradient `[N, levels, R]`.
    grad: &'a [f32],
    active: Option<&'a [bool]>,
}

impl Backward<'_> {
    #[inline(always)]
    fn is_active(&self, point: usize) -> bool {
        let nowhere = self.points[3 * point..3 * point + 3].iter().any(|v| v.is_nan());
        !nowhere && self.active.is_none_or(|active| active[point])
    }

    #[inline(always)]
    fn grad_row<S: Simd>(&self, point: usize, level: usize) -> &[S::f32s] {
        let row = point * self.field.levels.len() + level;
        self.field.node::<S>(self.grad, row * self.field.channels)
    }

    /// Computes point, line and time gradients: each task walks one chunk of points into private line and time sums,
    /// which are then added up in chunk order.
    fn walk_points(
        &self,
        shape: &FieldShape,
        time: f32,
        grad_lines: &mut [f32],
        grad_times: &mut [f32],
        grad_points: &mut [f32],
    ) {
        let chunk = (self.points.len() / 3).div_ceil(BACKWARD_CHUNKS).max(BACKWARD_CHUNK_MIN);
        let partials: Vec<Vec<f32>> = grad_points
            .par_chunks_mut(3 * chunk)
            .enumerate()
            .with_max_len(1)
            .map(|(index, grad_points)| {
                let mut sums = vec![0.0; grad_lines.len() + self.field.time.len()];
                let (lines, times) = sums.split_at_mut(grad_lines.len());
                crate::arch().dispatch(PointChunk { input: self, first: index * chunk, grad_points, lines, times });
                sums
            })
            .collect();
        grad_lines.fill(0.0);
        grad_times.fill(0.0);
        let mut time_sum = vec![0.0; self.field.time.len()];
        for partial in &partials {
            let (lines, times) = partial.split_at(grad_lines.len());
            for (sum, part) in grad_lines.iter_mut().zip(lines) {
                *sum += part;
            }
            for (sum, part) in time_sum.iter_mut().zip(times) {
                *sum += part;
            }
        }
        let tap = Tap::unit(time, shape.time_knots);
        let r = shape.channels;
        for (span, sums) in shape.time_spans().iter().zip(time_sum.chunks_exact(r)) {
            for (knot, weight) in [(tap.lo, 1.0 - tap.frac), (tap.hi, tap.frac)] {
                let targets = &mut grad_times[span.offset + knot * r..][..r];
                for (target, sum) in targets.iter_mut().zip(sums) {
                    *target += weight * sum;
                }
            }
        }
    }

    /// Computes plane gradients: each task owns a band of rows of one plane, clears it and walks, in point order, the
    /// points that touch it.
    fn scatter_planes(&self, shape: &FieldShape, grad_planes: &mut [f32]) {
        let levels = self.field.levels.len();
        // Planes xz and yz share the slow axis z, so the bands of y and z serve all three.
        let bands: Vec<Vec<Vec<u32>>> =
            (0..2 * levels).into_par_iter().map(|i| self.points_by_band(i / 2, 1 + i % 2)).collect();
        let mut tasks = Vec::new();
        let mut rest = grad_planes;
        for (index, span) in shape.plane_spans().iter().enumerate() {
            let (level, plane) = (index / 3, index % 3);
            let row = span.width * shape.channels;
            let (own, tail) = rest.split_at_mut(span.height * row);
            rest = tail;
            let points = &bands[2 * level + PLANE_AXES[plane].1 - 1];
            for (band, target) in own.chunks_mut(BAND_ROWS * row).enumerate() {
                tasks.push(PlaneBand {
                    input: self,
                    level,
                    plane,
                    first_row: band * BAND_ROWS,
                    points: &points[band],
                    target,
                });
            }
        }
        tasks.into_par_iter().with_max_len(1).for_each(|task| crate::arch().dispatch(task));
    }

    /// Returns the active points that touch each band of [`BAND_ROWS`] nodes along `axis`, ascending.
    fn points_by_band(&self, level: usize, axis: usize) -> Vec<Vec<u32>> {
        let n = self.field.levels[level].n;
        let count = n[axis].div_ceil(BAND_ROWS);
        let expected = self.points.len() / 3 / count;
        let mut bands = vec![Vec::with_capacity(expected + expected / 4); count];
        for (i, point) in self.points.chunks_exact(3).enumerate() {
            if self.is_active(i) {
                let tap = Tap::point(point, n)[axis];
                let (lo, hi) = (tap.lo / BAND_ROWS, tap.hi / BAND_ROWS);
                bands[lo].push(i as u32);
                if hi != lo {
                    bands[hi].push(i as u32);
                }
            }
        }
        bands
    }
}

struct PointChunk<'a> {
    input: &'a Backward<'a>,
    first: usize,
    grad_points: &'a mut [f32],
    lines: &'a mut [f32],
    times: &'a mut [f32],
}

impl WithSimd for PointChunk<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        if self.input.field.channels.is_multiple_of(S::F32_LANES) {
            self.run(simd);
        } else {
            self.run(Scalar::new());
        }
    }
}

impl PointChunk<'_> {
    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        for i in 0..self.grad_points.len() / 3 {
            let mut along = [Lanes::splat(simd, 0.0); 3];
            if self.input.is_active(self.first + i) {
                for level in 0..self.input.field.levels.len() {
                    self.visit(simd, self.first + i, level, &mut along);
                }
            }
            for axis in 0..3 {
                self.grad_points[3 * i + axis] = along[axis].sum();
            }
        }
    }

    /// Processes one point at one level; adds its gradient, lane by lane, to `along` x, y, z.
    #[inline(always)]
    fn visit<S: Simd>(&mut self, simd: S, i: usize, index: usize, along: &mut [Lanes<S>; 3]) {
        let (field, r) = (&self.input.field, self.input.field.channels);
        let level = &field.levels[index];
        let taps = &Tap::point(&self.input.points[3 * i..3 * i + 3], level.n);
        let xy = field.quad::<0, S>(simd, level, taps);
        let xz = field.quad::<1, S>(simd, level, taps);
        let yz = field.quad::<2, S>(simd, level, taps);
        let x = field.pair(simd, level, taps, 0);
        let y = field.pair(simd, level, taps, 1);
        let z = field.pair(simd, level, taps, 2);
        let grad = self.input.grad_row::<S>(i, index);
        let time = field.node::<S>(&field.time, index * r);
        let time_sum = S::as_mut_simd_f32s(&mut self.times[index * r..][..r]).0;
        let lines = S::as_mut_simd_f32s(self.lines).0;
        let add = |target: &mut S::f32s, value: Lanes<S>, weight: Lanes<S>| {
            *target = value.mul_add(weight, Lanes::new(simd, *target)).v;
        };
        let mut slopes = [Lanes::splat(simd, 0.0); 3];
        for b in 0..r / S::F32_LANES {
            let (m_xy, xy_x, xy_y) = xy.at(b);
            let (m_xz, xz_x, xz_z) = xz.at(b);
            let (m_yz, yz_y, yz_z) = yz.at(b);
            let ((v_x, d_x), (v_y, d_y), (v_z, d_z)) = (x.at(b), y.at(b), z.at(b));
            let feature = Lanes::new(simd, grad[b]);
            let sum = m_xy.mul_add(v_z, m_xz.mul_add(v_y, m_yz * v_x));
            add(&mut time_sum[b], feature, sum);
            let space = feature * Lanes::new(simd, time[b]);
            let (g_xy, g_xz, g_yz) = (space * v_z, space * v_y, space * v_x);
            let g_line = [space * m_yz, space * m_xz, space * m_xy];
            let total = |a: Lanes<S>, (b, c), (d, e), (f, g)| {
                let a: Lanes<S> = Lanes::mul_add(b, c, a);
                Lanes::mul_add(f, g, Lanes::mul_add(d, e, a))
            };
            slopes[0] = total(slopes[0], (g_xy, xy_x), (g_xz, xz_x), (g_line[0], d_x));
            slopes[1] = total(slopes[1], (g_xy, xy_y), (g_yz, yz_y), (g_line[1], d_y));
            slopes[2] = total(slopes[2], (g_xz, xz_z), (g_yz, yz_z), (g_line[2], d_z));
            for axis in 0..3 {
                let tap = taps[axis];
                let lo = (level.lines[axis] + tap.lo * r) / S::F32_LANES + b;
                let hi = (level.lines[axis] + tap.hi * r) / S::F32_LANES + b;
                let frac = Lanes::splat(simd, tap.frac);
                add(&mut lines[lo], g_line[axis], Lanes::splat(simd, 1.0) - frac);
                add(&mut lines[hi], g_line[axis], frac);
            }
        }
        for axis in 0..3 {
            let slope = Lanes::splat(simd, taps[axis].slope);
            along[axis] = slopes[axis].mul_add(slope, along[axis]);
        }
    }
}

struct PlaneBand<'a> {
    input: &'a Backward<'a>,
    level: usize,
    plane: usize,
    first_row: usize,
    points: &'a [u32],
    target: &'a mut [f32],
}

impl WithSimd for PlaneBand<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        if self.input.field.channels.is_multiple_of(S::F32_LANES) {
            self.run(simd);
        } else {
            self.run(Scalar::new());
        }
    }
}

impl PlaneBand<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let (field, r) = (&self.input.field, self.input.field.channels);
        let blocks = r / S::F32_LANES;
        let level = &field.levels[self.level];
        let (fast, slow) = PLANE_AXES[self.plane];
        let width = level.n[fast];
        let rows = self.target.len() / (width * r);
        let time = field.node::<S>(&field.time, self.level * r);
        self.target.fill(0.0);
        let target = S::as_mut_simd_f32s(self.target).0;
        let mut gathered = vec![0.0; GATHER * r];
        for (at, &i) in self.points.iter().enumerate() {
            let slot = at % GATHER;
            if slot == 0 {
                let batch = &self.points[at..(at + GATHER).min(self.points.len())];
                for (&i, row) in batch.iter().zip(gathered.chunks_exact_mut(r)) {
                    let row = S::as_mut_simd_f32s(row).0;
                    row.copy_from_slice(self.input.grad_row::<S>(i as usize, self.level));
                }
            }
            let i = i as usize;
            let taps = &Tap::point(&self.input.points[3 * i..3 * i + 3], level.n);
            let line = field.pair(simd, level, taps, PLANE_LINE[self.plane]);
            let grad = field.node::<S>(&gathered, slot * r);
            let (f, s) = (taps[fast], taps[slow]);
            for (node, weight) in [(s.lo, 1.0 - s.frac), (s.hi, s.frac)] {
                let row = node.wrapping_sub(self.first_row);
                if row >= rows {
                    continue;
                }
                let left = Lanes::splat(simd, weight * (1.0 - f.frac));
                let right = Lanes::splat(simd, weight * f.frac);
                let lo = (row * width + f.lo) * blocks;
                let hi = (row * width + f.hi) * blocks;
                for b in 0..blocks {
                    let space = Lanes::new(simd, grad[b]) * Lanes::new(simd, time[b]);
                    let value = space * line.at(b).0;
                    for (at, weight) in [(lo + b, left), (hi + b, right)] {
                        let old = Lanes::new(simd, target[at]);
                        target[at] = value.mul_add(weight, old).v;
                    }
                }
            }
        }
    }
}
