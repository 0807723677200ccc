//! Parameters of a Gaussian's covariance, its projection to the screen, and the backward pass. The same arithmetic as
//! `cpu::covariance`; the kind of input is known when a kernel is compiled.

use super::project::View;
use crate::cube::is_finite;
use crate::splat::MINOR_SLACK;
use crate::turn::NO_ROTATION;
use burn_cubecl::cubecl;
use burn_cubecl::cubecl::prelude::*;

/// A covariance on screen, xx, xy, yy, without the dilation.
#[derive(CubeType)]
pub(super) struct OnScreen {
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
    pub u0: f32,
    pub u1: f32,
    pub u2: f32,
    pub v0: f32,
    pub v1: f32,
    pub v2: f32,
}

/// Projects the covariance of Gaussian `i`: `source` holds quaternions `[N, 4]`, or with `entries` the covariances
/// `[N, 6]`, in which case `log_scales` is unused.
#[cube]
pub(super) fn on_screen(
    source: &[f32],
    log_scales: &[f32],
    view: &View,
    i: usize,
    #[comptime] entries: bool,
) -> OnScreen {
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
    view: &View,
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

/// Rotation matrix, normalised quaternion, scales, and the two rows of `J W R S`.
#[derive(CubeType)]
struct Factored {
    r00: f32,
    r01: f32,
    r02: f32,
    r10: f32,
    r11: f32,
    r12: f32,
    r20: f32,
    r21: f32,
    r22: f32,
    qw: f32,
    qx: f32,
    qy: f32,
    qz: f32,
    inverse_norm: f32,
    s0: f32,
    s1: f32,
    s2: f32,
    a0: f32,
    a1: f32,
    a2: f32,
    b0: f32,
    b1: f32,
    b2: f32,
}

#[cube]
fn factored(rotations: &[f32], log_scales: &[f32], view: &View, i: usize) -> Factored {
    let (w, x, y, z) = (rotations[4 * i], rotations[4 * i + 1], rotations[4 * i + 2], rotations[4 * i + 3]);
    let norm2 = w * w + x * x + y * y + z * z;
    let has_length = norm2 > comptime!(NO_ROTATION);
    let inverse_norm = select(has_length, 1.0f32 / f32::sqrt(max(norm2, comptime!(NO_ROTATION))), 0.0f32);
    // a zero quaternion means no rotation
    let qw = select(has_length, w * inverse_norm, 1.0f32);
    let qx = x * inverse_norm;
    let qy = y * inverse_norm;
    let qz = z * inverse_norm;
    let r00 = 1.0f32 - 2.0f32 * (qy * qy + qz * qz);
    let r01 = 2.0f32 * (qx * qy - qw * qz);
    let r02 = 2.0f32 * (qx * qz + qw * qy);
    let r10 = 2.0f32 * (qx * qy + qw * qz);
    let r11 = 1.0f32 - 2.0f32 * (qx * qx + qz * qz);
    let r12 = 2.0f32 * (qy * qz - qw * qx);
    let r20 = 2.0f32 * (qx * qz - qw * qy);
    let r21 = 2.0f32 * (qy * qz + qw * qx);
    let r22 = 1.0f32 - 2.0f32 * (qx * qx + qy * qy);
    let s0 = f32::exp(log_scales[3 * i]);
    let s1 = f32::exp(log_scales[3 * i + 1]);
    let s2 = f32::exp(log_scales[3 * i + 2]);
    let a0 = s0 * (view.u0 * r00 + view.u1 * r10 + view.u2 * r20);
    let a1 = s1 * (view.u0 * r01 + view.u1 * r11 + view.u2 * r21);
    let a2 = s2 * (view.u0 * r02 + view.u1 * r12 + view.u2 * r22);
    let b0 = s0 * (view.v0 * r00 + view.v1 * r10 + view.v2 * r20);
    let b1 = s1 * (view.v0 * r01 + view.v1 * r11 + view.v2 * r21);
    let b2 = s2 * (view.v0 * r02 + view.v1 * r12 + view.v2 * r22);
    Factored {
        r00,
        r01,
        r02,
        r10,
        r11,
        r12,
        r20,
        r21,
        r22,
        qw,
        qx,
        qy,
        qz,
        inverse_norm,
        s0,
        s1,
        s2,
        a0,
        a1,
        a2,
        b0,
        b1,
        b2,
    }
}

#[cube]
fn factored_on_screen(rotations: &[f32], log_scales: &[f32], view: &View, i: usize) -> OnScreen {
    let f = factored(rotations, log_scales, view, i);
    // |a x b|^2 is the determinant, free of cancellation (Lagrange's identity)
    let x0 = f.a1 * f.b2 - f.a2 * f.b1;
    let x1 = f.a2 * f.b0 - f.a0 * f.b2;
    let x2 = f.a0 * f.b1 - f.a1 * f.b0;
    OnScreen {
        xx: f.a0 * f.a0 + f.a1 * f.a1 + f.a2 * f.a2,
        xy: f.a0 * f.b0 + f.a1 * f.b1 + f.a2 * f.b2,
        yy: f.b0 * f.b0 + f.b1 * f.b1 + f.b2 * f.b2,
        determinant: x0 * x0 + x1 * x1 + x2 * x2,
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
    view: &View,
    va: f32,
    vb: f32,
    vc: f32,
    out_rotations: &mut [f32],
    out_log_scales: &mut [f32],
    i: usize,
) -> ByJacobian {
    let f = factored(rotations, log_scales, view, i);
    // Cov = X X^T, X = (J W)(R S)
    let x00 = 2.0f32 * (va * f.a0 + vb * f.b0);
    let x01 = 2.0f32 * (va * f.a1 + vb * f.b1);
    let x02 = 2.0f32 * (va * f.a2 + vb * f.b2);
    let x10 = 2.0f32 * (vb * f.a0 + vc * f.b0);
    let x11 = 2.0f32 * (vb * f.a1 + vc * f.b1);
    let x12 = 2.0f32 * (vb * f.a2 + vc * f.b2);
    // dL/d(R S) = (J W)^T vX, its columns not yet scaled
    let m00 = view.u0 * x00 + view.v0 * x10;
    let m01 = view.u0 * x01 + view.v0 * x11;
    let m02 = view.u0 * x02 + view.v0 * x12;
    let m10 = view.u1 * x00 + view.v1 * x10;
    let m11 = view.u1 * x01 + view.v1 * x11;
    let m12 = view.u1 * x02 + view.v1 * x12;
    let m20 = view.u2 * x00 + view.v2 * x10;
    let m21 = view.u2 * x01 + view.v2 * x11;
    let m22 = view.u2 * x02 + view.v2 * x12;
    out_log_scales[3 * i] = f.s0 * (m00 * f.r00 + m10 * f.r10 + m20 * f.r20);
    out_log_scales[3 * i + 1] = f.s1 * (m01 * f.r01 + m11 * f.r11 + m21 * f.r21);
    out_log_scales[3 * i + 2] = f.s2 * (m02 * f.r02 + m12 * f.r12 + m22 * f.r22);

    // back through the rotation matrix and the normalisation of the quaternion
    let (v00, v01, v02) = (m00 * f.s0, m01 * f.s1, m02 * f.s2);
    let (v10, v11, v12) = (m10 * f.s0, m11 * f.s1, m12 * f.s2);
    let (v20, v21, v22) = (m20 * f.s0, m21 * f.s1, m22 * f.s2);
    let (w, x, y, z) = (f.qw, f.qx, f.qy, f.qz);
    let gw = 2.0f32 * (x * (v21 - v12) + y * (v02 - v20) + z * (v10 - v01));
    let gx = 2.0f32 * (-2.0f32 * x * (v11 + v22) + y * (v01 + v10) + z * (v02 + v20) + w * (v21 - v12));
    let gy = 2.0f32 * (x * (v01 + v10) - 2.0f32 * y * (v00 + v22) + z * (v12 + v21) + w * (v02 - v20));
    let gz = 2.0f32 * (x * (v02 + v20) + y * (v12 + v21) - 2.0f32 * z * (v00 + v11) + w * (v10 - v01));
    let along = gw * w + gx * x + gy * y + gz * z;
    out_rotations[4 * i] = (gw - along * w) * f.inverse_norm;
    out_rotations[4 * i + 1] = (gx - along * x) * f.inverse_norm;
    out_rotations[4 * i + 2] = (gy - along * y) * f.inverse_norm;
    out_rotations[4 * i + 3] = (gz - along * z) * f.inverse_norm;

    // dL/d(J W) = vX (R S)^T
    let (e00, e01, e02) = (x00 * f.s0, x01 * f.s1, x02 * f.s2);
    let (e10, e11, e12) = (x10 * f.s0, x11 * f.s1, x12 * f.s2);
    ByJacobian {
        u0: e00 * f.r00 + e01 * f.r01 + e02 * f.r02,
        u1: e00 * f.r10 + e01 * f.r11 + e02 * f.r12,
        u2: e00 * f.r20 + e01 * f.r21 + e02 * f.r22,
        v0: e10 * f.r00 + e11 * f.r01 + e12 * f.r02,
        v1: e10 * f.r10 + e11 * f.r11 + e12 * f.r12,
        v2: e10 * f.r20 + e11 * f.r21 + e12 * f.r22,
    }
}

/// The two rows of `J W Sigma`.
#[derive(CubeType)]
struct Product {
    a0: f32,
    a1: f32,
    a2: f32,
    b0: f32,
    b1: f32,
    b2: f32,
}

#[cube]
fn product(entries: &[f32], view: &View, i: usize) -> Product {
    let (xx, xy, xz) = (entries[6 * i], entries[6 * i + 1], entries[6 * i + 2]);
    let (yy, yz, zz) = (entries[6 * i + 3], entries[6 * i + 4], entries[6 * i + 5]);
    Product {
        a0: view.u0 * xx + view.u1 * xy + view.u2 * xz,
        a1: view.u0 * xy + view.u1 * yy + view.u2 * yz,
        a2: view.u0 * xz + view.u1 * yz + view.u2 * zz,
        b0: view.v0 * xx + view.v1 * xy + view.v2 * xz,
        b1: view.v0 * xy + view.v1 * yy + view.v2 * yz,
        b2: view.v0 * xz + view.v1 * yz + view.v2 * zz,
    }
}

#[cube]
fn entries_on_screen(entries: &[f32], view: &View, i: usize) -> OnScreen {
    let p = product(entries, view, i);
    let xx = p.a0 * view.u0 + p.a1 * view.u1 + p.a2 * view.u2;
    let xy = p.a0 * view.v0 + p.a1 * view.v1 + p.a2 * view.v2;
    let yy = p.b0 * view.v0 + p.b1 * view.v1 + p.b2 * view.v2;
    let d = projected_determinant(entries, view, i);
    OnScreen { xx, xy, yy, determinant: d.value, valid: d.semidefinite }
}

#[cube]
fn entries_backward(
    entries: &[f32],
    view: &View,
    va: f32,
    vb: f32,
    vc: f32,
    out_entries: &mut [f32],
    i: usize,
) -> ByJacobian {
    // Cov = (J W) Sigma (J W)^T: dL/dSigma = (J W)^T V (J W) and dL/d(J W) = 2 V (J W) Sigma
    let (p0, p1, p2) = (va * view.u0 + vb * view.v0, va * view.u1 + vb * view.v1, va * view.u2 + vb * view.v2);
    let (q0, q1, q2) = (vb * view.u0 + vc * view.v0, vb * view.u1 + vc * view.v1, vb * view.u2 + vc * view.v2);
    out_entries[6 * i] = view.u0 * p0 + view.v0 * q0;
    out_entries[6 * i + 1] = 2.0f32 * (view.u0 * p1 + view.v0 * q1);
    out_entries[6 * i + 2] = 2.0f32 * (view.u0 * p2 + view.v0 * q2);
    out_entries[6 * i + 3] = view.u1 * p1 + view.v1 * q1;
    out_entries[6 * i + 4] = 2.0f32 * (view.u1 * p2 + view.v1 * q2);
    out_entries[6 * i + 5] = view.u2 * p2 + view.v2 * q2;
    let p = product(entries, view, i);
    ByJacobian {
        u0: 2.0f32 * (va * p.a0 + vb * p.b0),
        u1: 2.0f32 * (va * p.a1 + vb * p.b1),
        u2: 2.0f32 * (va * p.a2 + vb * p.b2),
        v0: 2.0f32 * (vb * p.a0 + vc * p.b0),
        v1: 2.0f32 * (vb * p.a1 + vc * p.b1),
        v2: 2.0f32 * (vb * p.a2 + vc * p.b2),
    }
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
fn projected_determinant(entries: &[f32], view: &View, i: usize) -> Determinant {
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
    let n0 = view.u1 * view.v2 - view.u2 * view.v1;
    let n1 = view.u2 * view.v0 - view.u0 * view.v2;
    let n2 = view.u0 * view.v1 - view.u1 * view.v0;
    let across = 2.0f32 * (n0 * n1 * a01 + n0 * n2 * a02 + n1 * n2 * a12);
    let form = n0 * n0 * a00 + n1 * n1 * a11 + n2 * n2 * a22 + across;
    // negative only through rounding
    Determinant { value: max(form, 0.0f32) * trace * trace, semidefinite }
}
