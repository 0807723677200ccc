//! Reading the field around one point on a GPU: the nodes that a feature touches, with values and slopes.

use crate::cube::prelude::*;

#[derive(CubeType)]
pub(super) struct CubeTap {
    pub lo: usize,
    pub hi: usize,
    pub frac: f32,
    /// d(grid coordinate) / d(normalised coordinate); 0 where clamped.
    pub slope: f32,
}

#[cube]
fn tap(coordinate: f32, n: u32) -> CubeTap {
    let last = f32::cast_from(n - 1u32);
    let raw = (coordinate * 0.5f32 + 0.5f32) * last;
    let grid = clamp(raw, 0.0f32, last);
    let mut lo = 0u32;
    if n > 1u32 {
        lo = min(u32::cast_from(grid), n - 2u32);
    }
    let inside = raw > 0.0f32 && raw < last;
    CubeTap {
        lo: lo as usize,
        hi: min(lo + 1u32, n - 1u32) as usize,
        frac: grid - f32::cast_from(lo),
        slope: select(inside, 0.5f32 * last, 0.0f32),
    }
}

#[cube]
fn is_nan(x: f32) -> bool {
    (u32::reinterpret(x) & 0x7FFF_FFFFu32) > 0x7F80_0000u32
}

/// Whether no coordinate of the point is NaN.
#[cube]
pub(super) fn is_somewhere(points: &[f32], i: usize) -> bool {
    !(is_nan(points[3 * i]) || is_nan(points[3 * i + 1]) || is_nan(points[3 * i + 2]))
}

/// Four nodes of a plane: their indices, the value, and the slopes along the fast and the slow grid coordinate.
#[derive(CubeType)]
pub(super) struct CubePlaneNodes {
    pub at00: usize,
    pub at01: usize,
    pub at10: usize,
    pub at11: usize,
    pub value: f32,
    pub fast: f32,
    pub slow: f32,
}

#[cube]
fn quad(planes: &[f32], base: usize, width: usize, fast: &CubeTap, slow: &CubeTap, channels: usize) -> CubePlaneNodes {
    let at00 = base + (slow.lo * width + fast.lo) * channels;
    let at01 = base + (slow.lo * width + fast.hi) * channels;
    let at10 = base + (slow.hi * width + fast.lo) * channels;
    let at11 = base + (slow.hi * width + fast.hi) * channels;
    let a = planes[at00];
    let c = planes[at10];
    let near = planes[at01] - a;
    let far = planes[at11] - c;
    let first = near * fast.frac + a;
    let by_slow = far * fast.frac + c - first;
    CubePlaneNodes {
        at00,
        at01,
        at10,
        at11,
        value: by_slow * slow.frac + first,
        fast: (far - near) * slow.frac + near,
        slow: by_slow,
    }
}

/// Two nodes of a line: their indices, the value, and the slope along the grid coordinate.
#[derive(CubeType)]
pub(super) struct CubeLineNodes {
    pub lo: usize,
    pub hi: usize,
    pub value: f32,
    pub slope: f32,
}

#[cube]
fn pair(lines: &[f32], base: usize, tap: &CubeTap, channels: usize) -> CubeLineNodes {
    let lo = base + tap.lo * channels;
    let hi = base + tap.hi * channels;
    let first = lines[lo];
    let slope = lines[hi] - first;
    CubeLineNodes { lo, hi, value: slope * tap.frac + first, slope }
}

/// Everything read for one feature of a point.
#[derive(CubeType)]
pub(super) struct CubeFieldSample {
    pub tx: CubeTap,
    pub ty: CubeTap,
    pub tz: CubeTap,
    pub xy: CubePlaneNodes,
    pub xz: CubePlaneNodes,
    pub yz: CubePlaneNodes,
    pub x: CubeLineNodes,
    pub y: CubeLineNodes,
    pub z: CubeLineNodes,
}

#[cube]
impl CubeFieldSample {
    /// Returns the feature before multiplication by its time factor.
    pub fn sum(&self) -> f32 {
        self.xy.value * self.z.value + (self.xz.value * self.y.value + self.yz.value * self.x.value)
    }
}

/// Reads feature `f` of point `i`; `levels` is laid out by `level_words`.
#[cube]
pub(super) fn read(
    planes: &[f32],
    lines: &[f32],
    points: &[f32],
    levels: &[u32],
    i: usize,
    f: usize,
    channels: usize,
) -> CubeFieldSample {
    let r = f % channels;
    let at = f / channels * 9;
    let (nx, ny, nz) = (levels[at], levels[at + 1], levels[at + 2]);
    let tx = tap(points[3 * i], nx);
    let ty = tap(points[3 * i + 1], ny);
    let tz = tap(points[3 * i + 2], nz);
    let xy = quad(planes, levels[at + 3] as usize + r, nx as usize, &tx, &ty, channels);
    let xz = quad(planes, levels[at + 4] as usize + r, nx as usize, &tx, &tz, channels);
    let yz = quad(planes, levels[at + 5] as usize + r, ny as usize, &ty, &tz, channels);
    let x = pair(lines, levels[at + 6] as usize + r, &tx, channels);
    let y = pair(lines, levels[at + 7] as usize + r, &ty, channels);
    let z = pair(lines, levels[at + 8] as usize + r, &tz, channels);
    CubeFieldSample { tx, ty, tz, xy, xz, yz, x, y, z }
}
