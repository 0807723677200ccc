//! Real spherical harmonics, as in [`crate::sh`], written out as the kernel language requires.

use crate::cube::prelude::*;
use crate::cube::vector::Vec3;
use crate::sh::{Bands, C0, C1, C2, C3, C3E, C4};

/// Returns the number of coefficients in use.
pub(super) fn count(degree: u32, even: bool) -> usize {
    if even { Bands::Even.count(degree as usize) } else { Bands::All.count(degree as usize) }
}

/// Writes the values of the basis functions up to `degree`, of all bands or of `even` ones, at the unit direction `d` to
/// `b` `[16]`.
#[cube]
pub(super) fn basis(b: &mut Array<f32>, d: &Vec3, #[comptime] degree: u32, #[comptime] even: bool) {
    let (x, y, z) = (d.x, d.y, d.z);
    b[0] = comptime!(C0);
    // where band 2 begins
    let s = comptime!(if even { 1usize } else { 4usize });
    if comptime!(!even && degree >= 1) {
        let c1 = comptime!(C1);
        b[1] = -c1 * y;
        b[2] = c1 * z;
        b[3] = -c1 * x;
    }
    if comptime!(degree >= 2) {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        let (k0, k1, k2) = (comptime!(C2[0]), comptime!(C2[1]), comptime!(C2[2]));
        b[s] = k0 * x * y;
        b[comptime!(s + 1)] = -k0 * y * z;
        b[comptime!(s + 2)] = k1 * (2.0f32 * zz - xx - yy);
        b[comptime!(s + 3)] = -k0 * x * z;
        b[comptime!(s + 4)] = k2 * (xx - yy);
    }
    if comptime!(even && degree >= 4) {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        let (k0, k1, k2, k3) = (comptime!(C4[0]), comptime!(C4[1]), comptime!(C4[2]), comptime!(C4[3]));
        let (k4, k5, k6) = (comptime!(C4[4]), comptime!(C4[5]), comptime!(C4[6]));
        let (one, three) = (7.0f32 * zz - 1.0f32, 7.0f32 * zz - 3.0f32);
        b[6] = k0 * x * y * (xx - yy);
        b[7] = -k1 * y * z * (3.0f32 * xx - yy);
        b[8] = k2 * x * y * one;
        b[9] = -k3 * y * z * three;
        b[10] = k4 * (zz * (35.0f32 * zz - 30.0f32) + 3.0f32);
        b[11] = -k3 * x * z * three;
        b[12] = k5 * (xx - yy) * one;
        b[13] = -k1 * x * z * (xx - 3.0f32 * yy);
        b[14] = k6 * (xx * (xx - 3.0f32 * yy) - yy * (3.0f32 * xx - yy));
    }
    if comptime!(!even && degree >= 3) {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        let (k0, k1, k2, k3) = (comptime!(C3[0]), comptime!(C3[1]), comptime!(C3[2]), comptime!(C3[3]));
        let e = comptime!(C3E);
        b[9] = -k0 * y * (3.0f32 * xx - yy);
        b[10] = k1 * x * y * z;
        b[11] = -k2 * y * (4.0f32 * zz - xx - yy);
        b[12] = k3 * z * (2.0f32 * zz - 3.0f32 * xx - 3.0f32 * yy);
        b[13] = -k2 * x * (4.0f32 * zz - xx - yy);
        b[14] = e * z * (xx - yy);
        b[15] = -k0 * x * (xx - 3.0f32 * yy);
    }
}

/// Writes the derivatives of the basis functions with respect to x, y and z of the direction (not renormalised), each
/// `[16]`.
#[cube]
pub(super) fn basis_derivative(
    dx: &mut Array<f32>,
    dy: &mut Array<f32>,
    dz: &mut Array<f32>,
    d: &Vec3,
    #[comptime] degree: u32,
    #[comptime] even: bool,
) {
    let (x, y, z) = (d.x, d.y, d.z);
    // where band 2 begins
    let s = comptime!(if even { 1usize } else { 4usize });
    #[unroll]
    for k in 0..16usize {
        dx[k] = 0.0f32;
        dy[k] = 0.0f32;
        dz[k] = 0.0f32;
    }
    if comptime!(!even && degree >= 1) {
        dy[1] = comptime!(-C1);
        dz[2] = comptime!(C1);
        dx[3] = comptime!(-C1);
    }
    if comptime!(degree >= 2) {
        let (k0, k1, k2) = (comptime!(C2[0]), comptime!(C2[1]), comptime!(C2[2]));
        dx[s] = k0 * y;
        dy[s] = k0 * x;
        dy[comptime!(s + 1)] = -k0 * z;
        dz[comptime!(s + 1)] = -k0 * y;
        dx[comptime!(s + 2)] = -2.0f32 * k1 * x;
        dy[comptime!(s + 2)] = -2.0f32 * k1 * y;
        dz[comptime!(s + 2)] = 4.0f32 * k1 * z;
        dx[comptime!(s + 3)] = -k0 * z;
        dz[comptime!(s + 3)] = -k0 * x;
        dx[comptime!(s + 4)] = 2.0f32 * k2 * x;
        dy[comptime!(s + 4)] = -2.0f32 * k2 * y;
    }
    if comptime!(even && degree >= 4) {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        let (k0, k1, k2, k3) = (comptime!(C4[0]), comptime!(C4[1]), comptime!(C4[2]), comptime!(C4[3]));
        let (k4, k5, k6) = (comptime!(C4[4]), comptime!(C4[5]), comptime!(C4[6]));
        let (one, three) = (7.0f32 * zz - 1.0f32, 7.0f32 * zz - 3.0f32);
        dx[6] = k0 * y * (3.0f32 * xx - yy);
        dy[6] = k0 * x * (xx - 3.0f32 * yy);
        dx[7] = -6.0f32 * k1 * x * y * z;
        dy[7] = -3.0f32 * k1 * z * (xx - yy);
        dz[7] = -k1 * y * (3.0f32 * xx - yy);
        dx[8] = k2 * y * one;
        dy[8] = k2 * x * one;
        dz[8] = 14.0f32 * k2 * x * y * z;
        dy[9] = -k3 * z * three;
        dz[9] = -3.0f32 * k3 * y * one;
        dz[10] = 20.0f32 * k4 * z * three;
        dx[11] = -k3 * z * three;
        dz[11] = -3.0f32 * k3 * x * one;
        dx[12] = 2.0f32 * k5 * x * one;
        dy[12] = -2.0f32 * k5 * y * one;
        dz[12] = 14.0f32 * k5 * z * (xx - yy);
        dx[13] = -3.0f32 * k1 * z * (xx - yy);
        dy[13] = 6.0f32 * k1 * x * y * z;
        dz[13] = -k1 * x * (xx - 3.0f32 * yy);
        dx[14] = 4.0f32 * k6 * x * (xx - 3.0f32 * yy);
        dy[14] = 4.0f32 * k6 * y * (yy - 3.0f32 * xx);
    }
    if comptime!(!even && degree >= 3) {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        let (k0, k1, k2, k3) = (comptime!(C3[0]), comptime!(C3[1]), comptime!(C3[2]), comptime!(C3[3]));
        let e = comptime!(C3E);
        dx[9] = -6.0f32 * k0 * x * y;
        dy[9] = -3.0f32 * k0 * (xx - yy);
        dx[10] = k1 * y * z;
        dy[10] = k1 * x * z;
        dz[10] = k1 * x * y;
        dx[11] = 2.0f32 * k2 * x * y;
        dy[11] = -k2 * (4.0f32 * zz - xx - 3.0f32 * yy);
        dz[11] = -8.0f32 * k2 * y * z;
        dx[12] = -6.0f32 * k3 * x * z;
        dy[12] = -6.0f32 * k3 * y * z;
        dz[12] = k3 * (6.0f32 * zz - 3.0f32 * xx - 3.0f32 * yy);
        dx[13] = -k2 * (4.0f32 * zz - 3.0f32 * xx - yy);
        dy[13] = 2.0f32 * k2 * x * y;
        dz[13] = -8.0f32 * k2 * x * z;
        dx[14] = 2.0f32 * e * x * z;
        dy[14] = -2.0f32 * e * y * z;
        dz[14] = e * (xx - yy);
        dx[15] = -3.0f32 * k0 * (xx - yy);
        dy[15] = 6.0f32 * k0 * x * y;
    }
}
