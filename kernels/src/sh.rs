//! Real spherical harmonics up to degree 3, or the even ones up to degree 4, in the order and with the signs of 3DGS.
//!
//! Under a headlight that shades both sides of a surface alike, a colour is the same seen along `d` and along `-d`: its
//! odd bands are zero.
//!
//! The constants are those of the reference rasteriser, digit for digit; GPU kernels use them too. [`exact_basis`], in
//! f64 from the definition, is independent of them: the oracle `splat::reference` and the rotation of coefficients in
//! edits use it.

use std::f64::consts::PI;

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

/// Band 4, for `xy (x^2 - y^2)`, `yz (3 x^2 - y^2)`, `xy (7 z^2 - 1)`, `yz (7 z^2 - 3)`, `35 z^4 - 30 z^2 + 3`,
/// `(x^2 - y^2) (7 z^2 - 1)` and `x^2 (x^2 - 3 y^2) - y^2 (3 x^2 - y^2)`.
pub const C4: [f32; 7] = [2.503_342_9, 1.770_130_8, 0.946_174_7, 0.669_046_5, 0.105_785_55, 0.473_087_35, 0.625_835_7];

/// The bands that a Gaussian's coefficients belong to. Their number K tells: see [`Bands::from_count`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bands {
    /// All up to a degree of 0 to 3: K is 1, 4, 9 or 16.
    All,
    /// The even ones up to a degree of 2 or 4: K is 6 or 15.
    Even,
}

impl Bands {
    /// Returns the bands of K coefficients and their highest degree; `None` if no degree has that many.
    #[inline(always)]
    pub const fn from_count(k: usize) -> Option<(Self, usize)> {
        match k {
            1 => Some((Self::All, 0)),
            4 => Some((Self::All, 1)),
            9 => Some((Self::All, 2)),
            16 => Some((Self::All, 3)),
            6 => Some((Self::Even, 2)),
            15 => Some((Self::Even, 4)),
            _ => None,
        }
    }

    /// Returns the bands of K coefficients, all for a K that no degree has.
    #[inline(always)]
    pub const fn of_any(k: usize) -> Self {
        match Self::from_count(k) {
            Some((bands, _)) => bands,
            None => Self::All,
        }
    }

    /// Returns the number of coefficients up to `degree`.
    #[inline(always)]
    pub const fn count(self, degree: usize) -> usize {
        match self {
            Self::All => (degree + 1) * (degree + 1),
            // bands 0, 2, ... of 1, 5, ... functions
            Self::Even => (degree / 2 + 1) * (2 * (degree / 2) + 1),
        }
    }
}

/// Returns the values of the basis functions of `bands` at the unit direction `d`, at most 16; those beyond `degree` are
/// zero.
#[inline(always)]
pub fn basis(d: [f32; 3], degree: usize, bands: Bands) -> [f32; 16] {
    match bands {
        Bands::All => basis_of_all(d, degree),
        Bands::Even => basis_of_even(d, degree),
    }
}

/// Returns the 25 basis functions up to degree 4 at the unit direction `d`, in f64 from their definition: with
/// single-precision constants, a rotation of coefficients would not be orthonormal to rounding.
pub fn exact_basis([x, y, z]: [f64; 3]) -> [f64; 25] {
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let norm = |a: f64| (a / PI).sqrt();
    let (c1, c2) = (norm(3.0) / 2.0, norm(15.0) / 2.0);
    let (c30, c31, c32) = (norm(35.0 / 2.0) / 4.0, norm(105.0) / 2.0, norm(21.0 / 2.0) / 4.0);
    let (c40, c41, c42, c43) = (0.75 * norm(35.0), 0.75 * norm(35.0 / 2.0), 0.75 * norm(5.0), 0.75 * norm(5.0 / 2.0));
    [
        norm(1.0) / 2.0,
        -c1 * y,
        c1 * z,
        -c1 * x,
        c2 * x * y,
        -c2 * y * z,
        norm(5.0) / 4.0 * (2.0 * zz - xx - yy),
        -c2 * x * z,
        c2 / 2.0 * (xx - yy),
        -c30 * y * (3.0 * xx - yy),
        c31 * x * y * z,
        -c32 * y * (4.0 * zz - xx - yy),
        norm(7.0) / 4.0 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -c32 * x * (4.0 * zz - xx - yy),
        c31 / 2.0 * z * (xx - yy),
        -c30 * x * (xx - 3.0 * yy),
        c40 * x * y * (xx - yy),
        -c41 * y * z * (3.0 * xx - yy),
        c42 * x * y * (7.0 * zz - 1.0),
        -c43 * y * z * (7.0 * zz - 3.0),
        3.0 / 16.0 * norm(1.0) * (zz * (35.0 * zz - 30.0) + 3.0),
        -c43 * x * z * (7.0 * zz - 3.0),
        c42 / 2.0 * (xx - yy) * (7.0 * zz - 1.0),
        -c41 * x * z * (xx - 3.0 * yy),
        c40 / 4.0 * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy)),
    ]
}

/// Returns the derivatives of the basis functions with respect to x, y and z of the direction (not renormalised).
#[inline(always)]
pub(crate) fn basis_derivative(d: [f32; 3], degree: usize, bands: Bands) -> [[f32; 16]; 3] {
    match bands {
        Bands::All => derivative_of_all(d, degree),
        Bands::Even => derivative_of_even(d, degree),
    }
}

#[inline(always)]
fn basis_of_even(d: [f32; 3], degree: usize) -> [f32; 16] {
    let [x, y, z] = d;
    let mut b = [0.0; 16];
    b[0] = C0;
    if degree >= 2 {
        b[1..6].copy_from_slice(&band_2(d));
    }
    if degree >= 4 {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        b[6] = C4[0] * x * y * (xx - yy);
        b[7] = -C4[1] * y * z * (3.0 * xx - yy);
        b[8] = C4[2] * x * y * (7.0 * zz - 1.0);
        b[9] = -C4[3] * y * z * (7.0 * zz - 3.0);
        b[10] = C4[4] * (zz * (35.0 * zz - 30.0) + 3.0);
        b[11] = -C4[3] * x * z * (7.0 * zz - 3.0);
        b[12] = C4[5] * (xx - yy) * (7.0 * zz - 1.0);
        b[13] = -C4[1] * x * z * (xx - 3.0 * yy);
        b[14] = C4[6] * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy));
    }
    b
}

#[inline(always)]
fn band_2([x, y, z]: [f32; 3]) -> [f32; 5] {
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [C2[0] * x * y, -C2[0] * y * z, C2[1] * (2.0 * zz - xx - yy), -C2[0] * x * z, C2[2] * (xx - yy)]
}

#[inline(always)]
fn derivative_of_band_2([x, y, z]: [f32; 3]) -> [[f32; 5]; 3] {
    [
        [C2[0] * y, 0.0, -2.0 * C2[1] * x, -C2[0] * z, 2.0 * C2[2] * x],
        [C2[0] * x, -C2[0] * z, -2.0 * C2[1] * y, 0.0, -2.0 * C2[2] * y],
        [0.0, -C2[0] * y, 4.0 * C2[1] * z, -C2[0] * x, 0.0],
    ]
}

#[inline(always)]
fn derivative_of_even(d: [f32; 3], degree: usize) -> [[f32; 16]; 3] {
    let [x, y, z] = d;
    let (mut dx, mut dy, mut dz) = ([0.0; 16], [0.0; 16], [0.0; 16]);
    if degree >= 2 {
        let band = derivative_of_band_2(d);
        [&mut dx, &mut dy, &mut dz].into_iter().zip(band).for_each(|(to, band)| to[1..6].copy_from_slice(&band));
    }
    if degree >= 4 {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        let (one, three) = (7.0 * zz - 1.0, 7.0 * zz - 3.0);
        (dx[6], dy[6]) = (C4[0] * y * (3.0 * xx - yy), C4[0] * x * (xx - 3.0 * yy));
        (dx[7], dy[7], dz[7]) = (-6.0 * C4[1] * x * y * z, -3.0 * C4[1] * z * (xx - yy), -C4[1] * y * (3.0 * xx - yy));
        (dx[8], dy[8], dz[8]) = (C4[2] * y * one, C4[2] * x * one, 14.0 * C4[2] * x * y * z);
        (dy[9], dz[9]) = (-C4[3] * z * three, -3.0 * C4[3] * y * one);
        dz[10] = 20.0 * C4[4] * z * three;
        (dx[11], dz[11]) = (-C4[3] * z * three, -3.0 * C4[3] * x * one);
        (dx[12], dy[12], dz[12]) = (2.0 * C4[5] * x * one, -2.0 * C4[5] * y * one, 14.0 * C4[5] * z * (xx - yy));
        (dx[13], dy[13], dz[13]) =
            (-3.0 * C4[1] * z * (xx - yy), 6.0 * C4[1] * x * y * z, -C4[1] * x * (xx - 3.0 * yy));
        (dx[14], dy[14]) = (4.0 * C4[6] * x * (xx - 3.0 * yy), 4.0 * C4[6] * y * (yy - 3.0 * xx));
    }
    [dx, dy, dz]
}

#[inline(always)]
fn basis_of_all(d: [f32; 3], degree: usize) -> [f32; 16] {
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
        b[4..9].copy_from_slice(&band_2(d));
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

#[inline(always)]
fn derivative_of_all(d: [f32; 3], degree: usize) -> [[f32; 16]; 3] {
    let [x, y, z] = d;
    let (mut dx, mut dy, mut dz) = ([0.0; 16], [0.0; 16], [0.0; 16]);
    if degree >= 1 {
        dy[1] = -C1;
        dz[2] = C1;
        dx[3] = -C1;
    }
    if degree >= 2 {
        let band = derivative_of_band_2(d);
        [&mut dx, &mut dy, &mut dz].into_iter().zip(band).for_each(|(to, band)| to[4..9].copy_from_slice(&band));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_number_of_coefficients_tells_the_bands() {
        for (bands, degrees) in [(Bands::All, &[0, 1, 2, 3][..]), (Bands::Even, &[2, 4])] {
            for &degree in degrees {
                assert_eq!(Bands::from_count(bands.count(degree)), Some((bands, degree)));
            }
        }
        assert_eq!([0, 1, 2, 3, 4].map(|degree| Bands::Even.count(degree)), [1, 1, 6, 6, 15]);
        assert_eq!([0, 2, 5, 8, 25].map(Bands::from_count), [None; 5]);
    }

    #[test]
    fn even_bands_are_the_same_from_both_sides() {
        let d = [0.48, -0.6, 0.64];
        assert_eq!(basis(d, 4, Bands::Even), basis(d.map(|v: f32| -v), 4, Bands::Even));
        let (all, even) = (basis(d, 3, Bands::All), basis(d, 4, Bands::Even));
        assert_eq!((all[0], &all[4..9]), (even[0], &even[1..6]));
        assert!(even[15] == 0.0 && basis(d, 3, Bands::Even)[6..] == [0.0; 10]);
    }

    #[test]
    fn basis_has_the_constants_of_3dgs() {
        let [x, y, z] = [0.3, -0.5, 0.7].map(|c: f64| c / 0.83f64.sqrt());
        let b = exact_basis([x, y, z]);
        let expected = [
            (1, -0.488_602_5 * y),
            (4, 1.092_548_4 * x * y),
            (5, -1.092_548_4 * y * z),
            (6, 0.315_391_57 * (2.0 * z * z - x * x - y * y)),
            (8, 0.546_274_22 * (x * x - y * y)),
            (9, -0.590_043_6 * y * (3.0 * x * x - y * y)),
            (10, 2.890_611_4 * x * y * z),
            (11, -0.457_045_8 * y * (4.0 * z * z - x * x - y * y)),
            (12, 0.373_176_33 * z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y)),
            (14, 1.445_305_7 * z * (x * x - y * y)),
            (15, -0.590_043_6 * x * (x * x - 3.0 * y * y)),
        ];
        for (k, value) in expected {
            assert!((b[k] - value).abs() < 1e-7, "{k}");
        }
        assert!((b[0] - f64::from(C0)).abs() < 1e-7);
    }
}
