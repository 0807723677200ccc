//! Parameters of a Gaussian's covariance, its projection to the screen, and the backward pass.

use super::project::row;
use crate::splat::MINOR_SLACK;
use crate::turn::{NO_ROTATION, cross, dot};

/// Covariances of Gaussians, or gradients with respect to them; `T` holds the rows.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Covariances<T> {
    /// Rotations and scales, `R S S^T R^T`.
    Factored {
        /// Quaternions `[N, 4]`.
        rotations: T,
        /// Natural logarithms of the standard deviations `[N, 3]`.
        log_scales: T,
    },
    /// Entries xx, xy, xz, yy, yz, zz `[N, 6]`.
    Entries(T),
}

/// The gradient with respect to one Gaussian's covariance: its quaternion and log-scales, or its six entries and an
/// unused element.
pub(crate) type Gradient = [f32; 7];

impl<T> Covariances<T> {
    /// Returns the same variant with rows mapped by `f`.
    pub(crate) fn map<'a, U>(&'a self, mut f: impl FnMut(&'a T) -> U) -> Covariances<U> {
        match self {
            Self::Factored { rotations, log_scales } => {
                Covariances::Factored { rotations: f(rotations), log_scales: f(log_scales) }
            }
            Self::Entries(entries) => Covariances::Entries(f(entries)),
        }
    }
}

impl Covariances<Vec<f32>> {
    /// Splits the rows into chunks of `size` Gaussians.
    pub(crate) fn chunks_mut(&mut self, size: usize) -> Vec<Covariances<&mut [f32]>> {
        match self {
            Self::Factored { rotations, log_scales } => {
                let chunks = rotations.chunks_mut(4 * size).zip(log_scales.chunks_mut(3 * size));
                chunks.map(|(rotations, log_scales)| Covariances::Factored { rotations, log_scales }).collect()
            }
            Self::Entries(entries) => entries.chunks_mut(6 * size).map(Covariances::Entries).collect(),
        }
    }
}

impl Covariances<&mut [f32]> {
    /// Writes the gradient of Gaussian `j`.
    #[inline(always)]
    pub(crate) fn set(&mut self, j: usize, gradient: &Gradient) {
        match self {
            Self::Factored { rotations, log_scales } => {
                rotations[4 * j..][..4].copy_from_slice(&gradient[..4]);
                log_scales[3 * j..][..3].copy_from_slice(&gradient[4..]);
            }
            Self::Entries(entries) => entries[6 * j..][..6].copy_from_slice(&gradient[..6]),
        }
    }
}

/// One Gaussian's covariance, with the parts of its projection that the backward pass needs again.
pub(crate) enum Covariance {
    Factored(FactoredCovariance),
    Entries(Entries),
}

/// A covariance on screen, without the dilation.
pub(crate) struct ScreenCovariance {
    /// Its entries xx, xy, yy, pixels squared.
    pub entries: [f32; 3],
    /// Its determinant; NaN if the covariance is invalid, so that the Gaussian is culled.
    pub determinant: f32,
}

impl Covariance {
    /// Returns covariance `i` and its projection by `jw`, which is `J W` `[2, 3]`.
    #[inline(always)]
    pub(crate) fn project(all: Covariances<&[f32]>, i: usize, jw: &[[f32; 3]; 2]) -> (Self, ScreenCovariance) {
        match all {
            Covariances::Factored { rotations, log_scales } => {
                let one = FactoredCovariance::new(row(rotations, i), row(log_scales, i), jw);
                let on_screen = one.on_screen();
                (Self::Factored(one), on_screen)
            }
            Covariances::Entries(entries) => {
                let one = Entries::new(row(entries, i), jw);
                let on_screen = one.on_screen(jw);
                (Self::Entries(one), on_screen)
            }
        }
    }

    /// Maps the gradient with respect to the covariance on screen, a symmetric matrix with the entries `v` (xx, xy,
    /// yy), to those with respect to `jw` and to the covariance's parameters.
    #[inline(always)]
    pub(crate) fn backward(&self, jw: &[[f32; 3]; 2], v: [f32; 3]) -> ([[f32; 3]; 2], Gradient) {
        match self {
            Self::Factored(one) => one.backward(jw, v),
            Self::Entries(one) => one.backward(jw, v),
        }
    }
}

/// A covariance `R S S^T R^T`.
pub(crate) struct FactoredCovariance {
    /// The rotation matrix.
    rotation: [[f32; 3]; 3],
    /// Normalised quaternion and the inverse of its norm (0 for a zero quaternion).
    quaternion: [f32; 4],
    inverse_norm: f32,
    scales: [f32; 3],
    /// `J W R S`, `[2, 3]`; the projected covariance is this times its transpose.
    root: [[f32; 3]; 2],
}

impl FactoredCovariance {
    #[inline(always)]
    fn new(quaternion: [f32; 4], log_scales: [f32; 3], jw: &[[f32; 3]; 2]) -> Self {
        let norm2: f32 = quaternion.iter().map(|q| q * q).sum();
        let (inverse_norm, quaternion) = if norm2 > NO_ROTATION {
            let i = 1.0 / norm2.sqrt();
            (i, quaternion.map(|q| q * i))
        } else if norm2 <= NO_ROTATION {
            (0.0, [1.0, 0.0, 0.0, 0.0])
        } else {
            (f32::NAN, quaternion) // NaN: the Gaussian is culled
        };
        let rotation = rotation_matrix(quaternion);
        let scales = log_scales.map(f32::exp);
        let root = jw.map(|row: [f32; 3]| {
            std::array::from_fn(|k| {
                scales[k] * (row[0] * rotation[0][k] + row[1] * rotation[1][k] + row[2] * rotation[2][k])
            })
        });
        Self { rotation, quaternion, inverse_norm, scales, root }
    }

    #[inline(always)]
    fn on_screen(&self) -> ScreenCovariance {
        let [r0, r1]: [[f32; 3]; 2] = self.root;
        // |r0 x r1|^2 is the determinant, free of cancellation (Lagrange's identity)
        let cross = cross(r0, r1);
        ScreenCovariance { entries: [dot(r0, r0), dot(r0, r1), dot(r1, r1)], determinant: dot(cross, cross) }
    }

    #[inline(always)]
    fn backward(&self, jw: &[[f32; 3]; 2], [va, vb, vc]: [f32; 3]) -> ([[f32; 3]; 2], Gradient) {
        // Cov = X X^T, X = (J W)(R S)
        let x = self.root;
        let vx: [[f32; 3]; 2] = [
            std::array::from_fn(|k| 2.0 * (va * x[0][k] + vb * x[1][k])),
            std::array::from_fn(|k| 2.0 * (vb * x[0][k] + vc * x[1][k])),
        ];
        // dL/d(R S) = (J W)^T vX and dL/d(J W) = vX (R S)^T
        let v_rs: [[f32; 3]; 3] =
            std::array::from_fn(|r| std::array::from_fn(|k| jw[0][r] * vx[0][k] + jw[1][r] * vx[1][k]));
        let v_jw: [[f32; 3]; 2] = std::array::from_fn(|r| {
            std::array::from_fn(|k| (0..3).map(|m| vx[r][m] * self.rotation[k][m] * self.scales[m]).sum())
        });
        let log_scale: [f32; 3] =
            std::array::from_fn(|k| self.scales[k] * (0..3).map(|r| v_rs[r][k] * self.rotation[r][k]).sum::<f32>());
        let rotation = self.rotation_gradient(&v_rs);
        let gradient = std::array::from_fn(|k| if k < 4 { rotation[k] } else { log_scale[k - 4] });
        (v_jw, gradient)
    }

    /// Propagates the gradient back through the rotation matrix and the normalisation of the quaternion.
    #[inline(always)]
    fn rotation_gradient(&self, v_rs: &[[f32; 3]; 3]) -> [f32; 4] {
        let v: [[f32; 3]; 3] = std::array::from_fn(|r| std::array::from_fn(|k| v_rs[r][k] * self.scales[k]));
        let [w, x, y, z] = self.quaternion;
        let q = [
            2.0 * (x * (v[2][1] - v[1][2]) + y * (v[0][2] - v[2][0]) + z * (v[1][0] - v[0][1])),
            2.0 * (-2.0 * x * (v[1][1] + v[2][2])
                + y * (v[0][1] + v[1][0])
                + z * (v[0][2] + v[2][0])
                + w * (v[2][1] - v[1][2])),
            2.0 * (x * (v[0][1] + v[1][0]) - 2.0 * y * (v[0][0] + v[2][2])
                + z * (v[1][2] + v[2][1])
                + w * (v[0][2] - v[2][0])),
            2.0 * (x * (v[0][2] + v[2][0]) + y * (v[1][2] + v[2][1]) - 2.0 * z * (v[0][0] + v[1][1])
                + w * (v[1][0] - v[0][1])),
        ];
        let along: f32 = q.iter().zip(&self.quaternion).map(|(a, b)| a * b).sum();
        std::array::from_fn(|k| (q[k] - along * self.quaternion[k]) * self.inverse_norm)
    }
}

#[inline(always)]
fn rotation_matrix([w, x, y, z]: [f32; 4]) -> [[f32; 3]; 3] {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// A covariance given by its entries.
pub(crate) struct Entries {
    /// `J W Sigma`, `[2, 3]`.
    product: [[f32; 3]; 2],
    /// As [`ScreenCovariance::determinant`].
    determinant: f32,
}

impl Entries {
    #[inline(always)]
    fn new(entries: [f32; 6], jw: &[[f32; 3]; 2]) -> Self {
        let [xx, xy, xz, yy, yz, zz] = entries;
        let product = jw.map(|row| [dot(row, [xx, xy, xz]), dot(row, [xy, yy, yz]), dot(row, [xz, yz, zz])]);
        Self { product, determinant: projected_determinant(entries, jw) }
    }

    #[inline(always)]
    fn on_screen(&self, jw: &[[f32; 3]; 2]) -> ScreenCovariance {
        let entries = [dot(self.product[0], jw[0]), dot(self.product[0], jw[1]), dot(self.product[1], jw[1])];
        ScreenCovariance { entries, determinant: self.determinant }
    }

    #[inline(always)]
    fn backward(&self, jw: &[[f32; 3]; 2], [va, vb, vc]: [f32; 3]) -> ([[f32; 3]; 2], Gradient) {
        // Cov = (J W) Sigma (J W)^T: dL/d(J W) = 2 V (J W) Sigma and dL/dSigma = (J W)^T V (J W)
        let turned = |rows: &[[f32; 3]; 2]| -> [[f32; 3]; 2] {
            [
                std::array::from_fn(|k| va * rows[0][k] + vb * rows[1][k]),
                std::array::from_fn(|k| vb * rows[0][k] + vc * rows[1][k]),
            ]
        };
        let v_jw = turned(&self.product).map(|row| row.map(|v| 2.0 * v));
        let w = turned(jw);
        let v = |r: usize, k: usize| jw[0][r] * w[0][k] + jw[1][r] * w[1][k];
        (v_jw, [v(0, 0), 2.0 * v(0, 1), 2.0 * v(0, 2), v(1, 1), 2.0 * v(1, 2), v(2, 2), 0.0])
    }
}

/// Returns the determinant of `(J W) Sigma (J W)^T` from the minors of Sigma (Cauchy-Binet formula), which loses less
/// to cancellation than the entries of the product do. NaN if Sigma is not positive semi-definite (a principal minor is
/// negative beyond [`MINOR_SLACK`]) or not finite.
#[inline(always)]
fn projected_determinant(entries: [f32; 6], jw: &[[f32; 3]; 2]) -> f32 {
    let trace = (entries[0] + entries[3] + entries[5]).max(f32::MIN_POSITIVE);
    // as fractions of the trace, whose products cannot overflow if the matrix is semi-definite
    let scale = 1.0 / trace;
    let [xx, xy, xz, yy, yz, zz] = entries.map(|v| v * scale);
    // the adjugate, also symmetric
    let (a00, a11, a22) = (yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy);
    let (a01, a02, a12) = (xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - xx * yz);
    // products of small numbers may round to 0
    let above = |minor: f32, diagonal: f32| minor >= -MINOR_SLACK * diagonal - f32::MIN_POSITIVE;
    let semidefinite = xx >= 0.0
        && yy >= 0.0
        && zz >= 0.0
        && above(a00, yy * zz)
        && above(a11, xx * zz)
        && above(a22, xx * yy)
        && above(xx * a00 + xy * a01 + xz * a02, xx * yy * zz);
    if !semidefinite {
        return f32::NAN;
    }
    let [n0, n1, n2] = cross(jw[0], jw[1]);
    let form = n0 * n0 * a00 + n1 * n1 * a11 + n2 * n2 * a22 + 2.0 * (n0 * n1 * a01 + n0 * n2 * a02 + n1 * n2 * a12);
    // negative only through rounding
    form.max(0.0) * trace * trace
}

#[cfg(test)]
mod tests {
    use super::projected_determinant;

    /// Two rows of a projection.
    const JW: [[f32; 3]; 2] = [[90.0, 10.0, -20.0], [-15.0, 80.0, 30.0]];

    #[test]
    fn only_products_count_as_semidefinite() {
        for factor in [
            [[1.0, 0.0, 0.0], [0.3, 2.0, 0.0], [-0.7, 0.1, 0.5]],
            [[1e-3, 0.0, 0.0], [7e2, 1e-3, 0.0], [3e2, 2e-4, 1e-5]], // a needle
            [[1.0, 0.5, 0.0], [0.7, 0.35, 0.0], [-0.1, -0.05, 0.0]], // of rank 1
            [[1e9, 0.0, 0.0], [0.0, 1e-9, 0.0], [1e9, 1e-9, 1e-9]],
            [[0.0; 3]; 3],
        ] {
            let product = |a: usize, b: usize| (0..3).map(|k| factor[a][k] * factor[b][k]).sum::<f32>();
            let entries = [product(0, 0), product(0, 1), product(0, 2), product(1, 1), product(1, 2), product(2, 2)];
            assert!(projected_determinant(entries, &JW) >= 0.0, "{entries:?}");
        }
        for entries in [
            [-1.0, 0.0, 0.0, 1.0, 0.0, 1.0],
            [1.0, 1.1, 0.0, 1.0, 0.0, 1.0],
            [1.0, 0.0, -1.1, 1.0, 0.0, 1.0],
            [1.0, 0.0, 0.0, 0.0, 0.1, 1.0],
            [1.0, -0.9, -0.9, 1.0, -0.9, 1.0], // its 2 x 2 minors are positive
            [1.0, f32::NAN, 0.0, 1.0, 0.0, 1.0],
            [f32::INFINITY, 0.0, 0.0, 1.0, 0.0, 1.0],
            [1.0, 0.0, 0.0, 1.0, f32::INFINITY, 1.0],
            [1e30, 1e38, 0.0, 1e30, 0.0, 1.0],
        ] {
            assert!(projected_determinant(entries, &JW).is_nan(), "{entries:?}");
        }
    }

    #[test]
    fn flat_and_thin_products_are_semidefinite() {
        let mut state = 1u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u64 << 23) as f32 - 1.0
        };
        for _ in 0..100_000 {
            let scales: [f32; 3] = std::array::from_fn(|_| (12.0 * next()).exp());
            let factor: [[f32; 3]; 3] = std::array::from_fn(|_| std::array::from_fn(|k| next() * scales[k]));
            let product = |a: usize, b: usize| (0..3).map(|k| factor[a][k] * factor[b][k]).sum::<f32>();
            let entries = [product(0, 0), product(0, 1), product(0, 2), product(1, 1), product(1, 2), product(2, 2)];
            assert!(projected_determinant(entries, &JW) >= 0.0, "{entries:?}");
        }
    }

    #[test]
    fn the_determinant_matches_that_of_the_product() {
        for [xx, xy, xz, yy, yz, zz] in [
            [0.3f32, 0.1, -0.05, 0.2, 0.02, 0.4],
            [2.0, 0.9, 0.01, 1.0, 0.0, 1e-3],
            [1e4, 0.0, 0.0, 5e-3, 1e-3, 5e-3], // a needle along an axis
        ] {
            let sigma = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
            let entry = |r: usize, s: usize| -> f64 {
                let places = (0..3).flat_map(|k| (0..3).map(move |l| (k, l)));
                places.map(|(k, l)| [JW[r][k], sigma[k][l], JW[s][l]].map(f64::from).iter().product::<f64>()).sum()
            };
            let exact = entry(0, 0) * entry(1, 1) - entry(0, 1) * entry(1, 0);
            let ours = f64::from(projected_determinant([xx, xy, xz, yy, yz, zz], &JW));
            assert!((ours / exact - 1.0).abs() < 1e-5, "{ours} for {exact}");
        }
    }
}
