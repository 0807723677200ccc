//! Real spherical harmonics up to degree 3, in the order and with the signs of 3DGS.
//!
//! The constants are those of the reference rasteriser, digit for digit; GPU kernels use them too. The oracle
//! `splat::reference`, in f64 from the definition, and the rotation of coefficients in the main crate, which needs f64,
//! are independent of them.

/// The constant basis function, `1 / (2 sqrt(pi))`.
pub const C0: f32 = 0.282_094_79;
/// Band 1.
pub const C1: f32 = 0.488_602_51;
/// Band 2, for `xy`, `2 z^2 - x^2 - y^2` and `x^2 - y^2`.
pub const C2: [f32; 3] = [1.092_548_4, 0.315_391_57, 0.546_274_2];
/// Band 3, for `y (3 x^2 - y^2)`, `xyz`, `y (4 z^2 - x^2 - y^2)` and `z (2 z^2 - 3 x^2 - 3 y^2)`.
pub const C3: [f32; 4] = [0.590_043_6, 2.890_611_4, 0.457_045_8, 0.373_176_33];
/// Band 3, for `z (x^2 - y^2)`.
pub const C3E: f32 = 1.445_305_7;

/// Returns the values of the 16 basis functions at the unit direction `d`; those beyond `degree` are zero.
#[inline(always)]
#[must_use]
pub fn basis(d: [f32; 3], degree: usize) -> [f32; 16] {
    let [x, y, z] = d;
    let mut b = [0.0; 16];
    b[0] = C0;
    if degree >= 1 {
        b[1] = -C1 * y;
        b[2] = C1 * z;
        b[3] = -C1 * x;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    if degree >= 2 {
        b[4] = C2[0] * x * y;
        b[5] = -C2[0] * y * z;
        b[6] = C2[1] * (2.0 * zz - xx - yy);
        b[7] = -C2[0] * x * z;
        b[8] = C2[2] * (xx - yy);
    }
    if degree >= 3 {
        b[9] = -C3[0] * y * (3.0 * xx - yy);
        b[10] = C3[1] * x * y * z;
        b[11] = -C3[2] * y * (4.0 * zz - xx - yy);
        b[12] = C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
        b[13] = -C3[2] * x * (4.0 * zz - xx - yy);
        b[14] = C3E * z * (xx - yy);
        b[15] = -C3[0] * x * (xx - 3.0 * yy);
    }
    b
}

/// Returns the derivatives of the basis functions with respect to x, y and z of the direction (not renormalised).
#[inline(always)]
pub(crate) fn basis_derivative(d: [f32; 3], degree: usize) -> [[f32; 16]; 3] {
    let [x, y, z] = d;
    let (mut dx, mut dy, mut dz) = ([0.0; 16], [0.0; 16], [0.0; 16]);
    if degree >= 1 {
        dy[1] = -C1;
        dz[2] = C1;
        dx[3] = -C1;
    }
    if degree >= 2 {
        (dx[4], dy[4]) = (C2[0] * y, C2[0] * x);
        (dy[5], dz[5]) = (-C2[0] * z, -C2[0] * y);
        (dx[6], dy[6], dz[6]) = (-2.0 * C2[1] * x, -2.0 * C2[1] * y, 4.0 * C2[1] * z);
        (dx[7], dz[7]) = (-C2[0] * z, -C2[0] * x);
        (dx[8], dy[8]) = (2.0 * C2[2] * x, -2.0 * C2[2] * y);
    }
    if degree >= 3 {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        (dx[9], dy[9]) = (-6.0 * C3[0] * x * y, -3.0 * C3[0] * (xx - yy));
        (dx[10], dy[10], dz[10]) = (C3[1] * y * z, C3[1] * x * z, C3[1] * x * y);
        (dx[11], dy[11], dz[11]) = (2.0 * C3[2] * x * y, -C3[2] * (4.0 * zz - xx - 3.0 * yy), -8.0 * C3[2] * y * z);
        (dx[12], dy[12], dz[12]) =
            (-6.0 * C3[3] * x * z, -6.0 * C3[3] * y * z, C3[3] * (6.0 * zz - 3.0 * xx - 3.0 * yy));
        (dx[13], dy[13], dz[13]) = (-C3[2] * (4.0 * zz - 3.0 * xx - yy), 2.0 * C3[2] * x * y, -8.0 * C3[2] * x * z);
        (dx[14], dy[14], dz[14]) = (2.0 * C3E * x * z, -2.0 * C3E * y * z, C3E * (xx - yy));
        (dx[15], dy[15]) = (-3.0 * C3[0] * (xx - yy), 6.0 * C3[0] * x * y);
    }
    [dx, dy, dz]
}
