//! Parameters of a Gaussian's covariance, its projection to the screen, and the backward pass. The same arithmetic as
//! `cpu::covariance`; the kind of input is known when a kernel is compiled.

use super::project::ProjectedMean;
use crate::cube::is_finite;
use crate::cube::prelude::*;
use crate::cube::vector::{Vec3, cross, dot, products, scaled, store_vec3, sum_of_three, sum_of_two, vec3_at};
use crate::splat::MINOR_SLACK;
use crate::turn::NO_ROTATION;

/// A covariance on screen, xx, xy, yy, without the dilation.
#[derive(CubeType)]
pub(super) struct CubeScreenCovariance {
    pub xx: f32,
    pub xy: f32,
    pub yy: f32,
    pub determinant: f32,
    /// False if the input is not finite or not a covariance.
    pub valid: bool,
}

/// Gradients with respect to the two rows of `J W`.
#[derive(CubeType)]
pub(super) struct ByJacobian {
    pub u: Vec3,
    pub v: Vec3,
}

/// Projects the covariance of Gaussian `i`: `source` holds quaternions `[N, 4]`, or with `entries` the covariances
/// `[N, 6]`, in which case `log_scales` is unused.
#[cube]
pub(super) fn on_screen(
    source: &[f32],
    log_scales: &[f32],
    view: &ProjectedMean,
    i: usize,
    #[comptime] entries: bool,
) -> CubeScreenCovariance {
    if comptime!(entries) {
        entries_on_screen(source, view, i)
    } else {
        factored_on_screen(source, log_scales, view, i)
    }
}

/// Maps the gradient with respect to the covariance on screen, a symmetric matrix with the entries `va` (xx), `vb` and
/// `vc` (yy), to that with respect to `J W`, which is returned, and to that with respect to the covariance's
/// parameters, which is written.
#[cube]
pub(super) fn backward(
    source: &[f32],
    log_scales: &[f32],
    view: &ProjectedMean,
    va: f32,
    vb: f32,
    vc: f32,
    out_source: &mut [f32],
    out_log_scales: &mut [f32],
    i: usize,
    #[comptime] entries: bool,
) -> ByJacobian {
    if comptime!(entries) {
        entries_backward(source, view, va, vb, vc, out_source, i)
    } else {
        factored_backward(source, log_scales, view, va, vb, vc, out_source, out_log_scales, i)
    }
}

/// Writes the gradient of a Gaussian that was not drawn.
#[cube]
pub(super) fn no_gradient(out_source: &mut [f32], out_log_scales: &mut [f32], i: usize, #[comptime] entries: bool) {
    let width = comptime!(if entries { 6usize } else { 4usize });
    #[unroll]
    for k in 0..width {
        out_source[width * i + k] = 0.0f32;
    }
    if comptime!(!entries) {
        #[unroll]
        for k in 0..3usize {
            out_log_scales[3 * i + k] = 0.0f32;
        }
    }
}

/// The factors of a covariance.
#[derive(CubeType)]
struct CovarianceFactors {
    /// Columns of the rotation matrix.
    r0: Vec3,
    r1: Vec3,
    r2: Vec3,
    /// The normalised quaternion, and the inverse of its former norm.
    w: f32,
    q: Vec3,
    inverse_norm: f32,
    scales: Vec3,
    /// The two rows of `J W R S`.
    a: Vec3,
    b: Vec3,
}

#[cube]
fn factored(rotations: &[f32], log_scales: &[f32], view: &ProjectedMean, i: usize) -> CovarianceFactors {
    let (w, x, y, z) = (rotations[4 * i], rotations[4 * i + 1], rotations[4 * i + 2], rotations[4 * i + 3]);
    let norm2 = w * w + x * x + y * y + z * z;
    let has_length = norm2 > comptime!(NO_ROTATION);
    let inverse_norm = select(has_length, 1.0f32 / f32::sqrt(max(norm2, comptime!(NO_ROTATION))), 0.0f32);
    // a zero quaternion means no rotation
    let w = select(has_length, w * inverse_norm, 1.0f32);
    let q = Vec3 { x: x * inverse_norm, y: y * inverse_norm, z: z * inverse_norm };
    let r0 = Vec3 {
        x: 1.0f32 - 2.0f32 * (q.y * q.y + q.z * q.z),
        y: 2.0f32 * (q.x * q.y + w * q.z),
        z: 2.0f32 * (q.x * q.z - w * q.y),
    };
    let r1 = Vec3 {
        x: 2.0f32 * (q.x * q.y - w * q.z),
        y: 1.0f32 - 2.0f32 * (q.x * q.x + q.z * q.z),
        z: 2.0f32 * (q.y * q.z + w * q.x),
    };
    let r2 = Vec3 {
        x: 2.0f32 * (q.x * q.z + w * q.y),
        y: 2.0f32 * (q.y * q.z - w * q.x),
        z: 1.0f32 - 2.0f32 * (q.x * q.x + q.y * q.y),
    };
    let s = vec3_at(log_scales, 3 * i);
    let scales = Vec3 { x: f32::exp(s.x), y: f32::exp(s.y), z: f32::exp(s.z) };
    let u = Vec3 { x: dot(&view.u, &r0), y: dot(&view.u, &r1), z: dot(&view.u, &r2) };
    let v = Vec3 { x: dot(&view.v, &r0), y: dot(&view.v, &r1), z: dot(&view.v, &r2) };
    let (a, b) = (products(&scales, &u), products(&scales, &v));
    CovarianceFactors { r0, r1, r2, w, q, inverse_norm, scales, a, b }
}

#[cube]
fn factored_on_screen(rotations: &[f32], log_scales: &[f32], view: &ProjectedMean, i: usize) -> CubeScreenCovariance {
    let f = factored(rotations, log_scales, view, i);
    // |a x b|^2 is the determinant, free of cancellation (Lagrange's identity)
    let across = cross(&f.a, &f.b);
    CubeScreenCovariance {
        xx: dot(&f.a, &f.a),
        xy: dot(&f.a, &f.b),
        yy: dot(&f.b, &f.b),
        determinant: dot(&across, &across),
        valid: is_finite(rotations[4 * i])
            && is_finite(rotations[4 * i + 1])
            && is_finite(rotations[4 * i + 2])
            && is_finite(rotations[4 * i + 3]),
    }
}

#[cube]
fn factored_backward(
    rotations: &[f32],
    log_scales: &[f32],
    view: &ProjectedMean,
    va: f32,
    vb: f32,
    vc: f32,
    out_rotations: &mut [f32],
    out_log_scales: &mut [f32],
    i: usize,
) -> ByJacobian {
    let f = factored(rotations, log_scales, view, i);
    // Cov = X X^T, X = (J W)(R S): the two rows of vX
    let (x0, x1) = (sum_of_two(va, &f.a, vb, &f.b), sum_of_two(vb, &f.a, vc, &f.b));
    let (x0, x1) = (scaled(&x0, 2.0f32), scaled(&x1, 2.0f32));
    // dL/d(R S) = (J W)^T vX, its columns not yet scaled
    let m0 = sum_of_two(x0.x, &view.u, x1.x, &view.v);
    let m1 = sum_of_two(x0.y, &view.u, x1.y, &view.v);
    let m2 = sum_of_two(x0.z, &view.u, x1.z, &view.v);
    let along = Vec3 { x: dot(&m0, &f.r0), y: dot(&m1, &f.r1), z: dot(&m2, &f.r2) };
    let by_log_scales = products(&f.scales, &along);
    store_vec3(out_log_scales, 3 * i, &by_log_scales);

    // back through the rotation matrix and the normalisation of the quaternion
    let (v0, v1, v2) = (scaled(&m0, f.scales.x), scaled(&m1, f.scales.y), scaled(&m2, f.scales.z));
    let (w, x, y, z) = (f.w, f.q.x, f.q.y, f.q.z);
    let gw = 2.0f32 * (x * (v1.z - v2.y) + y * (v2.x - v0.z) + z * (v0.y - v1.x));
    let gx = 2.0f32 * (-2.0f32 * x * (v1.y + v2.z) + y * (v1.x + v0.y) + z * (v2.x + v0.z) + w * (v1.z - v2.y));
    let gy = 2.0f32 * (x * (v1.x + v0.y) - 2.0f32 * y * (v0.x + v2.z) + z * (v2.y + v1.z) + w * (v2.x - v0.z));
    let gz = 2.0f32 * (x * (v2.x + v0.z) + y * (v2.y + v1.z) - 2.0f32 * z * (v0.x + v1.y) + w * (v0.y - v1.x));
    let along = gw * w + gx * x + gy * y + gz * z;
    out_rotations[4 * i] = (gw - along * w) * f.inverse_norm;
    out_rotations[4 * i + 1] = (gx - along * x) * f.inverse_norm;
    out_rotations[4 * i + 2] = (gy - along * y) * f.inverse_norm;
    out_rotations[4 * i + 3] = (gz - along * z) * f.inverse_norm;

    // dL/d(J W) = vX (R S)^T
    let (e0, e1) = (products(&x0, &f.scales), products(&x1, &f.scales));
    let u = sum_of_three(&e0, &f.r0, &f.r1, &f.r2);
    let v = sum_of_three(&e1, &f.r0, &f.r1, &f.r2);
    ByJacobian { u, v }
}

/// The two rows of `J W Sigma`.
#[derive(CubeType)]
struct Product {
    a: Vec3,
    b: Vec3,
}

#[cube]
fn product(entries: &[f32], view: &ProjectedMean, i: usize) -> Product {
    let x = vec3_at(entries, 6 * i);
    let y = Vec3 { x: x.y, y: entries[6 * i + 3], z: entries[6 * i + 4] };
    let z = Vec3 { x: x.z, y: y.z, z: entries[6 * i + 5] };
    let a = Vec3 { x: dot(&view.u, &x), y: dot(&view.u, &y), z: dot(&view.u, &z) };
    let b = Vec3 { x: dot(&view.v, &x), y: dot(&view.v, &y), z: dot(&view.v, &z) };
    Product { a, b }
}

#[cube]
fn entries_on_screen(entries: &[f32], view: &ProjectedMean, i: usize) -> CubeScreenCovariance {
    let p = product(entries, view, i);
    let (xx, xy, yy) = (dot(&p.a, &view.u), dot(&p.a, &view.v), dot(&p.b, &view.v));
    let d = projected_determinant(entries, view, i);
    CubeScreenCovariance { xx, xy, yy, determinant: d.value, valid: d.semidefinite }
}

#[cube]
fn entries_backward(
    entries: &[f32],
    view: &ProjectedMean,
    va: f32,
    vb: f32,
    vc: f32,
    out_entries: &mut [f32],
    i: usize,
) -> ByJacobian {
    // Cov = (J W) Sigma (J W)^T: dL/dSigma = (J W)^T V (J W) and dL/d(J W) = 2 V (J W) Sigma
    let (p, q) = (sum_of_two(va, &view.u, vb, &view.v), sum_of_two(vb, &view.u, vc, &view.v));
    out_entries[6 * i] = view.u.x * p.x + view.v.x * q.x;
    out_entries[6 * i + 1] = 2.0f32 * (view.u.x * p.y + view.v.x * q.y);
    out_entries[6 * i + 2] = 2.0f32 * (view.u.x * p.z + view.v.x * q.z);
    out_entries[6 * i + 3] = view.u.y * p.y + view.v.y * q.y;
    out_entries[6 * i + 4] = 2.0f32 * (view.u.y * p.z + view.v.y * q.z);
    out_entries[6 * i + 5] = view.u.z * p.z + view.v.z * q.z;
    let p = product(entries, view, i);
    let (u, v) = (sum_of_two(va, &p.a, vb, &p.b), sum_of_two(vb, &p.a, vc, &p.b));
    ByJacobian { u: scaled(&u, 2.0f32), v: scaled(&v, 2.0f32) }
}

/// Whether a principal minor is at least 0, up to rounding.
#[cube]
fn above(minor: f32, diagonal: f32) -> bool {
    minor >= comptime!(-MINOR_SLACK) * diagonal - comptime!(f32::MIN_POSITIVE)
}

/// A determinant on screen, and whether the matrix in the world is a covariance.
#[derive(CubeType)]
struct Determinant {
    value: f32,
    semidefinite: bool,
}

/// Returns the determinant of `(J W) Sigma (J W)^T` from the minors of Sigma, as in `cpu::covariance`.
#[cube]
fn projected_determinant(entries: &[f32], view: &ProjectedMean, i: usize) -> Determinant {
    let mut finite = true;
    #[unroll]
    for k in 0..6usize {
        finite = finite && is_finite(entries[6 * i + k]);
    }
    let sum = entries[6 * i] + entries[6 * i + 3] + entries[6 * i + 5];
    let trace = max(sum, comptime!(f32::MIN_POSITIVE));
    // as fractions of the trace, whose products cannot overflow if the matrix is semi-definite
    let scale = 1.0f32 / trace;
    let (xx, xy, xz) = (entries[6 * i] * scale, entries[6 * i + 1] * scale, entries[6 * i + 2] * scale);
    let (yy, yz, zz) = (entries[6 * i + 3] * scale, entries[6 * i + 4] * scale, entries[6 * i + 5] * scale);
    // the adjugate, also symmetric
    let (a00, a11, a22) = (yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy);
    let (a01, a02, a12) = (xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - xx * yz);
    let semidefinite = finite
        && xx >= 0.0f32
        && yy >= 0.0f32
        && zz >= 0.0f32
        && above(a00, yy * zz)
        && above(a11, xx * zz)
        && above(a22, xx * yy)
        && above(xx * a00 + xy * a01 + xz * a02, xx * yy * zz);
    let n = cross(&view.u, &view.v);
    let across = 2.0f32 * (n.x * n.y * a01 + n.x * n.z * a02 + n.y * n.z * a12);
    let form = n.x * n.x * a00 + n.y * n.y * a11 + n.z * n.z * a22 + across;
    // negative only through rounding
    Determinant { value: max(form, 0.0f32) * trace * trace, semidefinite }
}
