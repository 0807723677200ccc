//! Rotation of real spherical harmonics up to degree 4, in the order and with the signs of 3DGS.
//!
//! A rotation maps each band `l` onto itself. The matrix of a band is found by evaluating its 2l + 1 functions at 2l +
//! 1 fixed directions, before and after the rotation, and solving once: exact up to rounding, all in f64.

use crate::model::sh::degrees;
use std::f64::consts::PI;
use volseggs_kernels::sh::exact_basis;

/// The matrices of bands 1 to 4 for one rotation.
#[derive(Clone, Debug, PartialEq)]
pub struct ShRotation {
    /// Row-major matrices of 3x3, 5x5, 7x7 and 9x9.
    bands: [Vec<f64>; 4],
}

impl ShRotation {
    /// Prepares the rotation of colours by `matrix` (row-major, orthonormal): afterwards, the colour seen in direction
    /// `R d` is the one seen before in direction `d`.
    pub fn new(matrix: [[f64; 3]; 3]) -> Self {
        Self { bands: std::array::from_fn(|i| band_matrix(i + 1, matrix)) }
    }

    /// Rotates the coefficients `[K, 3]` of one Gaussian in place; K is 1, 4, 9 or 16, or 6 or 15 with even bands alone.
    pub fn rotate(&self, sh: &mut [f32]) {
        let mut start = 1;
        for l in degrees(sh.len() / 3) {
            let (n, matrix) = (2 * l + 1, &self.bands[l - 1]);
            let Some(band) = sh.get_mut(3 * start..3 * (start + n)) else {
                return;
            };
            let mut old = [0.0; 27];
            for (o, c) in old.iter_mut().zip(band.iter()) {
                *o = f64::from(*c);
            }
            for (row, out) in matrix.chunks_exact(n).zip(band.chunks_exact_mut(3)) {
                for c in 0..3 {
                    out[c] = row.iter().enumerate().map(|(k, m)| m * old[3 * k + c]).sum::<f64>() as f32;
                }
            }
            start += n;
        }
    }
}

/// Returns `A^-1 B`, where `A` holds the functions of the band at fixed directions and `B` those at the directions
/// rotated back.
fn band_matrix(l: usize, r: [[f64; 3]; 3]) -> Vec<f64> {
    let n = 2 * l + 1;
    let mut rows: Vec<Vec<f64>> = (0..n)
        .map(|j| {
            let d = direction(j, n);
            let back = std::array::from_fn(|c| r[0][c] * d[0] + r[1][c] * d[1] + r[2][c] * d[2]);
            let mut row = exact_basis(d)[l * l..l * l + n].to_vec();
            row.extend_from_slice(&exact_basis(back)[l * l..l * l + n]);
            row
        })
        .collect();
    eliminate(&mut rows, n);
    rows.iter().flat_map(|row| row[n..].iter().copied()).collect()
}

/// Turns `[A | B]` into `[1 | A^-1 B]` by Gauss-Jordan elimination with pivoting; `A` is fixed and invertible.
fn eliminate(rows: &mut [Vec<f64>], n: usize) {
    for k in 0..n {
        let pivot = (k..n).fold(k, |best, i| if rows[i][k].abs() > rows[best][k].abs() { i } else { best });
        rows.swap(k, pivot);
        let scale = 1.0 / rows[k][k];
        rows[k].iter_mut().for_each(|v| *v *= scale);
        let lead = rows[k].clone();
        for (i, row) in rows.iter_mut().enumerate() {
            let factor = row[k];
            if i != k {
                row.iter_mut().zip(&lead).for_each(|(v, p)| *v -= factor * p);
            }
        }
    }
}

/// Returns the `j`th of `n` unit directions on a spiral over the half sphere. Half is enough: within a band, the
/// function at `-d` equals that at `d` up to the sign, so opposite directions would make the matrix singular.
fn direction(j: usize, n: usize) -> [f64; 3] {
    let z = (j as f64 + 0.5) / n as f64;
    let (sin, cos) = (j as f64 * PI * (3.0 - 5f64.sqrt())).sin_cos();
    let ring = (1.0 - z * z).sqrt();
    [ring * cos, ring * sin, z]
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};
    use proptest::prelude::*;

    fn rows(m: DMat3) -> [[f64; 3]; 3] {
        m.transpose().to_cols_array_2d()
    }

    /// The green channel of coefficients, of even bands where their number is that of these.
    fn colour(sh: &[f32], d: DVec3) -> f64 {
        let all = exact_basis(d.to_array());
        let even = [6, 15].contains(&(sh.len() / 3));
        let functions = (0..all.len()).filter(|k| !even || k.isqrt().is_multiple_of(2)).map(|k| all[k]);
        functions.zip(sh.chunks_exact(3)).map(|(b, c)| b * f64::from(c[1])).sum()
    }

    proptest! {
        #[test]
        fn colour_turns_with_the_gaussian(
            axis in prop::array::uniform3(-1.0f64..1.0), angle in -7.0f64..7.0,
            d in prop::array::uniform3(-1.0f64..1.0), sh in prop::collection::vec(-1.0f32..1.0, 48),
        ) {
            let (axis, d) = (DVec3::from(axis), DVec3::from(d));
            prop_assume!(axis.length() > 0.1 && d.length() > 0.1);
            let (r, d) = (DMat3::from_axis_angle(axis.normalize(), angle), d.normalize());
            let turn = ShRotation::new(rows(r));
            for k in [1, 4, 9, 16, 6, 15] {
                let before = &sh[..3 * k];
                let mut after = before.to_vec();
                turn.rotate(&mut after);
                prop_assert!((colour(&after, r * d) - colour(before, d)).abs() < 1e-5);
            }
        }

        #[test]
        fn matrices_are_orthogonal(axis in prop::array::uniform3(-1.0f64..1.0), angle in -7.0f64..7.0) {
            let axis = DVec3::from(axis);
            prop_assume!(axis.length() > 0.1);
            let turn = ShRotation::new(rows(DMat3::from_axis_angle(axis.normalize(), angle)));
            for (l, m) in (1..).zip(&turn.bands) {
                let n = 2 * l + 1;
                for i in 0..n {
                    for j in 0..n {
                        let dot: f64 = (0..n).map(|k| m[i * n + k] * m[j * n + k]).sum();
                        prop_assert!((dot - f64::from(u8::from(i == j))).abs() < 1e-12, "{l} {i} {j} {dot}");
                    }
                }
            }
        }
    }

    #[test]
    fn no_rotation_changes_nothing_and_band_0_never_changes() {
        let sh: Vec<f32> = (0..48).map(|i| (i as f32 * 0.37).sin()).collect();
        let mut same = sh.clone();
        ShRotation::new(rows(DMat3::IDENTITY)).rotate(&mut same);
        assert!(sh.iter().zip(&same).all(|(a, b)| (a - b).abs() < 1e-6));
        let mut turned = sh.clone();
        ShRotation::new(rows(DMat3::from_rotation_x(1.0))).rotate(&mut turned);
        assert_eq!(sh[..3], turned[..3]);
        assert_ne!(sh[3..], turned[3..]);
    }
}
