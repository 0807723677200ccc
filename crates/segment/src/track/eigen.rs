//! 3x3 algebra for covariances: the covariance of a Gaussian and the eigenvectors of a symmetric matrix.

/// A 3x3 matrix by rows.
pub type Matrix = [[f64; 3]; 3];

/// Returns the rotation matrix of a quaternion `wxyz`, normalised here; the identity for one of length 0.
pub fn rotation(quaternion: [f32; 4]) -> Matrix {
    let length = quaternion.iter().map(|&v| f64::from(v) * f64::from(v)).sum::<f64>().sqrt();
    if length <= 0.0 {
        return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    }
    let [w, x, y, z] = quaternion.map(|v| f64::from(v) / length);
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// Returns the eigenvalues of a symmetric matrix in descending order, with their unit eigenvectors as rows, by Jacobi
/// rotations.
///
/// The component of largest magnitude of each of the first two vectors is positive, and the three are right-handed, so
/// that the same matrix always gives the same vectors.
pub fn symmetric_eigen(matrix: Matrix) -> ([f64; 3], Matrix) {
    let mut a = matrix;
    let mut v: Matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for _ in 0..50 {
        let off = a[0][1].powi(2) + a[0][2].powi(2) + a[1][2].powi(2);
        let size = a[0][0].powi(2) + a[1][1].powi(2) + a[2][2].powi(2);
        if off <= 1e-30 * size || off == 0.0 {
            break;
        }
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            rotate(&mut a, &mut v, p, q);
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| a[j][j].total_cmp(&a[i][i]));
    let mut axes = order.map(|i| [v[0][i], v[1][i], v[2][i]]);
    for axis in axes.iter_mut().take(2) {
        let lead = (0..3).fold(0, |best, i| if axis[i].abs() > axis[best].abs() + 1e-12 { i } else { best });
        if axis[lead] < 0.0 {
            *axis = axis.map(|c| -c);
        }
    }
    let [x, y, _] = axes;
    axes[2] = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]];
    (order.map(|i| a[i][i]), axes)
}

/// Applies one Jacobi rotation that makes `a[p][q]` zero.
fn rotate(a: &mut Matrix, v: &mut Matrix, p: usize, q: usize) {
    if a[p][q] == 0.0 {
        return;
    }
    let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
    let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
    let t = if theta == 0.0 { 1.0 } else { t };
    let c = 1.0 / (t * t + 1.0).sqrt();
    let s = t * c;
    for k in 0..3 {
        let (kp, kq) = (a[k][p], a[k][q]);
        a[k][p] = c * kp - s * kq;
        a[k][q] = s * kp + c * kq;
    }
    for k in 0..3 {
        let (pk, qk) = (a[p][k], a[q][k]);
        a[p][k] = c * pk - s * qk;
        a[q][k] = s * pk + c * qk;
    }
    for row in v.iter_mut() {
        let (p0, q0) = (row[p], row[q]);
        row[p] = c * p0 - s * q0;
        row[q] = s * p0 + c * q0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns `R diag(values) R^T`.
    fn sandwich(r: &Matrix, values: [f64; 3]) -> Matrix {
        let mut out = [[0.0; 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                out[i][j] = (0..3).map(|k| r[i][k] * values[k] * r[j][k]).sum();
            }
        }
        out
    }

    proptest! {
        #[test]
        fn eigenvectors_rebuild_the_matrix(q in prop::array::uniform4(-1f32..1.0), s in prop::array::uniform3(0f64..9.0)) {
            let matrix = sandwich(&rotation(q), s);
            let (values, axes) = symmetric_eigen(matrix);
            prop_assert!(values[0] >= values[1] && values[1] >= values[2]);
            for i in 0..3 {
                for j in 0..3 {
                    let rebuilt: f64 = (0..3).map(|k| values[k] * axes[k][i] * axes[k][j]).sum();
                    prop_assert!((rebuilt - matrix[i][j]).abs() < 1e-9);
                }
            }
            let mut sorted = s;
            sorted.sort_by(|a, b| b.total_cmp(a));
            prop_assert!((0..3).all(|i| (values[i] - sorted[i]).abs() < 1e-9));
        }
    }

    #[test]
    fn a_quarter_turn_about_z_takes_x_to_y() {
        let r = rotation([1.0, 0.0, 0.0, 1.0]);
        assert!((r[1][0] - 1.0).abs() < 1e-6 && r[0][0].abs() < 1e-6);
        assert_eq!(rotation([0.0; 4])[0], [1.0, 0.0, 0.0]);
        assert_eq!(symmetric_eigen([[0.0; 3]; 3]).0, [0.0; 3]);
    }
}
