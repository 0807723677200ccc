//! Real spherical harmonics up to degree 3, as in [`crate::sh`], written out as the kernel language requires.

use crate::sh::{C0, C1, C2, C3, C3E};
use burn_cubecl::cubecl;
use burn_cubecl::cubecl::prelude::*;

/// Writes the values of the basis functions up to `degree` at the unit direction (x, y, z) to `b` `[16]`.
#[cube]
pub(super) fn basis(b: &mut Array<f32>, x: f32, y: f32, z: f32, #[comptime] degree: u32) {
    b[0] = comptime!(C0);
    if comptime!(degree >= 1) {
        let c1 = comptime!(C1);
        b[1] = -c1 * y;
        b[2] = c1 * z;
        b[3] = -c1 * x;
    }
    if comptime!(degree >= 2) {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        let (k0, k1, k2) = (comptime!(C2[0]), comptime!(C2[1]), comptime!(C2[2]));
        b[4] = k0 * x * y;
        b[5] = -k0 * y * z;
        b[6] = k1 * (2.0f32 * zz - xx - yy);
        b[7] = -k0 * x * z;
        b[8] = k2 * (xx - yy);
    }
    if comptime!(degree >= 3) {
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
    x: f32,
    y: f32,
    z: f32,
    #[comptime] degree: u32,
) {
    #[unroll]
    for k in 0..16usize {
        dx[k] = 0.0f32;
        dy[k] = 0.0f32;
        dz[k] = 0.0f32;
    }
    if comptime!(degree >= 1) {
        dy[1] = comptime!(-C1);
        dz[2] = comptime!(C1);
        dx[3] = comptime!(-C1);
    }
    if comptime!(degree >= 2) {
        let (k0, k1, k2) = (comptime!(C2[0]), comptime!(C2[1]), comptime!(C2[2]));
        dx[4] = k0 * y;
        dy[4] = k0 * x;
        dy[5] = -k0 * z;
        dz[5] = -k0 * y;
        dx[6] = -2.0f32 * k1 * x;
        dy[6] = -2.0f32 * k1 * y;
        dz[6] = 4.0f32 * k1 * z;
        dx[7] = -k0 * z;
        dz[7] = -k0 * x;
        dx[8] = 2.0f32 * k2 * x;
        dy[8] = -2.0f32 * k2 * y;
    }
    if comptime!(degree >= 3) {
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
