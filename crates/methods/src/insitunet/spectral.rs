//! The largest singular value of a matrix, tracked by one step of power iteration at a time.
//!
//! Miyato et al., "Spectral normalization for generative adversarial networks", ICLR 2018.

use burn::tensor::Tensor;

/// Minimum length by which vectors are divided, as in the published code.
const MIN_LENGTH: f64 = 1e-4;

/// Normalises a vector `[n, 1]` to length 1, or less if it is close to zero.
fn unit(x: Tensor<2>) -> Tensor<2> {
    let length = x.clone().square().sum_dim(0).sqrt().clamp_min(MIN_LENGTH);
    x / length
}

/// Returns the next estimate of the left singular vector from the last one, `[outputs]`, and a matrix
/// `[outputs, inputs]`. Without gradients.
pub fn next(matrix: &Tensor<2>, left: &Tensor<1>) -> Tensor<1> {
    let matrix = matrix.clone().detach();
    let [outputs, _] = matrix.dims();
    let right = right(&matrix, left);
    unit(matrix.matmul(right)).reshape([outputs])
}

fn right(matrix: &Tensor<2>, left: &Tensor<1>) -> Tensor<2> {
    let [outputs, _] = matrix.dims();
    unit(matrix.clone().transpose().matmul(left.clone().detach().reshape([outputs, 1])))
}

/// The largest singular value `[1, 1]` from the estimate of its left vector, which is treated as constant: gradients
/// flow to the matrix.
pub fn norm(matrix: &Tensor<2>, left: &Tensor<1>) -> Tensor<2> {
    let [outputs, _] = matrix.dims();
    let right = right(&matrix.clone().detach(), left);
    left.clone().detach().reshape([1, outputs]).matmul(matrix.clone()).matmul(right)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::insitunet::layers::orthogonal;
    use crate::test_support::device;
    use burn::tensor::TensorData;
    use volseggs_base::rng::{Purpose, Rng};
    use volseggs_core::model::params::to_vec;

    /// `U diag(values) V` with orthogonal U and V: a matrix built from its singular value decomposition.
    fn matrix(rows: usize, columns: usize, values: &[f32]) -> Vec<f32> {
        let mut rng = Rng::new(4, 0, Purpose::Custom(5));
        let n = values.len();
        let (u, v) = (orthogonal(&mut rng, rows, n), orthogonal(&mut rng, n, columns));
        let at = |i: usize, j: usize| (0..n).map(|k| u[i * n + k] * values[k] * v[k * columns + j]).sum();
        (0..rows * columns).map(|i| at(i / columns, i % columns)).collect()
    }

    #[test]
    fn it_comes_to_the_largest_singular_value() {
        for (rows, columns) in [(5, 9), (9, 5), (1, 4)] {
            let values: &[f32] = if rows == 1 { &[2.5] } else { &[0.3, 2.5, 1.0, 0.1] };
            let m = TensorData::new(matrix(rows, columns, values), [rows, columns]);
            let m = Tensor::<2>::from_data(m, &device());
            let mut left = Tensor::<1>::ones([rows], &device()).div_scalar((rows as f32).sqrt());
            let first = to_vec(norm(&m, &left))[0];
            for _ in 0..20 {
                left = next(&m, &left);
            }
            let found = to_vec(norm(&m, &left))[0];
            assert!(first <= 2.5001 && (found - 2.5).abs() < 1e-4, "{rows}x{columns}: {first}, then {found}");
        }
    }

    #[test]
    fn its_gradient_is_the_product_of_the_singular_vectors() {
        let on = device().autodiff();
        let values = matrix(4, 6, &[2.0, 0.7]);
        let at = |values: &[f32], device: &burn::tensor::Device| {
            Tensor::<2>::from_data(TensorData::new(values.to_vec(), [4, 6]), device)
        };
        let mut left = Tensor::<1>::ones([4], &on).div_scalar(2.0);
        let m = at(&values, &on).require_grad();
        for _ in 0..30 {
            left = next(&m, &left);
        }
        let gradients = norm(&m, &left).backward();
        let gradient = to_vec(m.grad(&gradients).unwrap());
        // at the maximum over both vectors, changes of the vectors do not contribute to the slope
        let plain = left.inner();
        let of = |values: &[f32]| {
            let m = at(values, &device());
            let settled = (0..30).fold(plain.clone(), |left, _| next(&m, &left));
            f64::from(to_vec(norm(&m, &settled))[0])
        };
        for i in 0..24 {
            let mut moved = values.clone();
            moved[i] += 1e-2;
            let up = of(&moved);
            moved[i] -= 2e-2;
            let slope = (up - of(&moved)) / 2e-2;
            assert!((slope - f64::from(gradient[i])).abs() < 2e-3, "{i}: {} for {slope}", gradient[i]);
        }
    }
}
