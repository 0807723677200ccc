//! Reading the field around one point: interpolation taps and the plane and line nodes they touch.
//! Shared by the forward and backward passes; nothing here writes or starts threads.

use super::params::FieldParams;
use super::shape::{FieldShape, LevelShape, PLANE_AXES};
use pulp::Simd;
use std::ops::{Add, Mul, Sub};

/// A vector of channels, as wide as the processor's vectors.
#[derive(Clone, Copy)]
pub(super) struct Lanes<S: Simd> {
    simd: S,
    pub(super) v: S::f32s,
}

impl<S: Simd> Add for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self::new(self.simd, self.simd.add_f32s(self.v, other.v))
    }
}

impl<S: Simd> Sub for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self::new(self.simd, self.simd.sub_f32s(self.v, other.v))
    }
}

impl<S: Simd> Mul for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self::new(self.simd, self.simd.mul_f32s(self.v, other.v))
    }
}

impl<S: Simd> Lanes<S> {
    #[inline(always)]
    pub(super) fn new(simd: S, v: S::f32s) -> Self {
        Self { simd, v }
    }

    #[inline(always)]
    pub(super) fn splat(simd: S, value: f32) -> Self {
        Self::new(simd, simd.splat_f32s(value))
    }

    /// `self * factor + addend`, fused where the processor has it.
    #[inline(always)]
    pub(super) fn mul_add(self, factor: Self, addend: Self) -> Self {
        let v = self.simd.mul_add_e_f32s(self.v, factor.v, addend.v);
        Self::new(self.simd, v)
    }

    #[inline(always)]
    pub(super) fn sum(self) -> f32 {
        self.simd.reduce_sum_f32s(self.v)
    }
}

/// Linear interpolation between nodes `lo` and `hi`.
#[derive(Clone, Copy)]
pub(super) struct Tap {
    pub(super) lo: usize,
    pub(super) hi: usize,
    pub(super) frac: f32,
    /// d(grid coordinate) / d(normalised coordinate); 0 where clamped.
    pub(super) slope: f32,
}

impl Tap {
    /// Returns the tap for `unit` in [0, 1] over `n` nodes; NaN maps to node 0 because `max` drops it.
    #[inline(always)]
    pub(super) fn unit(unit: f32, n: usize) -> Self {
        let last = (n - 1) as f32;
        let raw = unit * last;
        let grid = raw.max(0.0).min(last);
        let lo = (grid as u32 as usize).min(n.saturating_sub(2));
        Self {
            lo,
            hi: (lo + 1).min(n - 1),
            frac: grid - lo as f32,
            slope: if raw > 0.0 && raw < last { 0.5 * last } else { 0.0 },
        }
    }

    #[inline(always)]
    pub(super) fn point(point: &[f32], n: [usize; 3]) -> [Self; 3] {
        let tap = |axis: usize| Self::unit(point[axis] * 0.5 + 0.5, n[axis]);
        [tap(0), tap(1), tap(2)]
    }
}

/// One level: its grid and the offsets of its tensors in the flat buffers.
pub(super) struct GridLevel {
    pub(super) n: [usize; 3],
    pub(super) planes: [usize; 3],
    pub(super) lines: [usize; 3],
}

/// Data read by every task of one call.
pub(super) struct FieldData<'a> {
    pub(super) levels: Vec<GridLevel>,
    pub(super) channels: usize,
    pub(super) planes: &'a [f32],
    pub(super) lines: &'a [f32],
    /// Time row of every level at the call's time: `[levels, R]`.
    pub(super) time: Vec<f32>,
}

impl<'a> FieldData<'a> {
    pub(super) fn new(shape: &FieldShape, params: FieldParams<'a>, time: f32) -> Self {
        let (planes, lines) = (shape.plane_spans(), shape.line_spans());
        let level = |(i, level): (usize, &LevelShape)| GridLevel {
            n: level.resolution,
            planes: [0, 1, 2].map(|k| planes[3 * i + k].offset),
            lines: [0, 1, 2].map(|k| lines[3 * i + k].offset),
        };
        let tap = Tap::unit(time, shape.time_knots);
        let mut row = Vec::with_capacity(shape.features_len());
        for span in shape.time_spans() {
            let knot = |i: usize, r: usize| params.times[span.offset + i * shape.channels + r];
            row.extend((0..shape.channels).map(|r| {
                let lo = knot(tap.lo, r);
                lo + tap.frac * (knot(tap.hi, r) - lo)
            }));
        }
        Self {
            levels: shape.levels.iter().enumerate().map(level).collect(),
            channels: shape.channels,
            planes: params.planes,
            lines: params.lines,
            time: row,
        }
    }

    /// Returns the channels `[R]` of the node at `at` in a flat buffer.
    #[inline(always)]
    pub(super) fn node<'b, S: Simd>(&self, data: &'b [f32], at: usize) -> &'b [S::f32s] {
        S::as_simd_f32s(&data[at..][..self.channels]).0
    }

    /// Returns the nodes of plane `PLANE` (xy, xz, yz) around a point.
    #[inline(always)]
    pub(super) fn quad<const PLANE: usize, S: Simd>(
        &self,
        simd: S,
        level: &GridLevel,
        taps: &[Tap; 3],
    ) -> PlaneNodes<'a, S> {
        let (fast, slow) = PLANE_AXES[PLANE];
        let (f, s) = (taps[fast], taps[slow]);
        let lower = level.planes[PLANE] + s.lo * level.n[fast] * self.channels;
        let upper = level.planes[PLANE] + s.hi * level.n[fast] * self.channels;
        let (left, right) = (f.lo * self.channels, f.hi * self.channels);
        PlaneNodes {
            simd,
            rows: [
                self.node::<S>(self.planes, lower + left),
                self.node::<S>(self.planes, lower + right),
                self.node::<S>(self.planes, upper + left),
                self.node::<S>(self.planes, upper + right),
            ],
            fast: Lanes::splat(simd, f.frac),
            slow: Lanes::splat(simd, s.frac),
        }
    }

    /// Returns the nodes of the line along `axis` around a point.
    #[inline(always)]
    pub(super) fn pair<S: Simd>(&self, simd: S, level: &GridLevel, taps: &[Tap; 3], axis: usize) -> LineNodes<'a, S> {
        let (base, tap) = (level.lines[axis], taps[axis]);
        LineNodes {
            simd,
            rows: [
                self.node::<S>(self.lines, base + tap.lo * self.channels),
                self.node::<S>(self.lines, base + tap.hi * self.channels),
            ],
            frac: Lanes::splat(simd, tap.frac),
        }
    }
}

/// Two line nodes around a point.
pub(super) struct LineNodes<'a, S: Simd> {
    simd: S,
    rows: [&'a [S::f32s]; 2],
    frac: Lanes<S>,
}

impl<S: Simd> LineNodes<'_, S> {
    /// Returns the value of block `b` and its slope along the grid coordinate.
    #[inline(always)]
    pub(super) fn at(&self, b: usize) -> (Lanes<S>, Lanes<S>) {
        let lo = Lanes::new(self.simd, self.rows[0][b]);
        let slope = Lanes::new(self.simd, self.rows[1][b]) - lo;
        (slope.mul_add(self.frac, lo), slope)
    }
}

/// Four plane nodes around a point.
pub(super) struct PlaneNodes<'a, S: Simd> {
    simd: S,
    rows: [&'a [S::f32s]; 4],
    fast: Lanes<S>,
    slow: Lanes<S>,
}

impl<S: Simd> PlaneNodes<'_, S> {
    /// Returns the value of block `b` and its slopes along the fast and slow grid coordinates.
    #[inline(always)]
    pub(super) fn at(&self, b: usize) -> (Lanes<S>, Lanes<S>, Lanes<S>) {
        let a = Lanes::new(self.simd, self.rows[0][b]);
        let c = Lanes::new(self.simd, self.rows[2][b]);
        let near = Lanes::new(self.simd, self.rows[1][b]) - a;
        let far = Lanes::new(self.simd, self.rows[3][b]) - c;
        let first = near.mul_add(self.fast, a);
        let slow = far.mul_add(self.fast, c) - first;
        let fast = (far - near).mul_add(self.slow, near);
        (slow.mul_add(self.slow, first), fast, slow)
    }
}
