//! Four-dimensional rotations given by two unit quaternions.

use burn::tensor::Tensor;

/// Minimum squared length of a quaternion: one of zero length collapses its Gaussian to a point instead of giving NaN.
const MIN_SQUARE: f32 = 1e-24;

/// The component of a quaternion (w, i, j, k: 1 to 4) at each entry of a 4x4 matrix, with its sign.
type QuaternionLayout = [[i8; 4]; 4];

/// `v -> l v`, the left-isoclinic rotation.
const LEFT: QuaternionLayout = [[1, -2, -3, -4], [2, 1, -4, 3], [3, 4, 1, -2], [4, -3, 2, 1]];
/// `v -> v conj(r)`, the right-isoclinic rotation.
const RIGHT: QuaternionLayout = [[1, 2, 3, 4], [-2, 1, -4, 3], [-3, 4, 1, -2], [-4, -3, 2, 1]];

/// Rotation matrices `[N, 4, 4]` of x, y, z, t from quaternions `left` and `right` `[N, 4]` (w, i, j, k), normalised
/// inside: `v -> l v conj(r)` with `v = t + z i + y j + x k`, as in 4DGS. If the two are equal, time is unchanged.
pub fn rotation_matrices(left: Tensor<2>, right: Tensor<2>) -> Tensor<3> {
    rotations(left, right).permute([2, 0, 1])
}

/// As [`rotation_matrices`], with the Gaussians last, `[4, 4, N]`: a matrix row is then contiguous in memory, and each
/// operation runs over all Gaussians.
pub(super) fn rotations(left: Tensor<2>, right: Tensor<2>) -> Tensor<3> {
    let (left, right) = (matrix(unit(left), &LEFT), matrix(unit(right), &RIGHT));
    // their product, as a sum of outer products of a column and a row
    let term = |k: usize| left.clone().narrow(1, k, 1) * right.clone().narrow(0, k, 1);
    term(0) + term(1) + term(2) + term(3)
}

/// Normalises quaternions `[N, 4]`, returned as `[4, N]`.
fn unit(quaternions: Tensor<2>) -> Tensor<2> {
    let quaternions = quaternions.transpose();
    let square = (quaternions.clone() * quaternions.clone()).sum_dim(0);
    quaternions / square.clamp_min(MIN_SQUARE).sqrt()
}

/// The matrices `[4, 4, N]` of a layout, for the order x, y, z, t instead of t, z, y, x: rows and columns are reversed.
fn matrix(quaternions: Tensor<2>, layout: &QuaternionLayout) -> Tensor<3> {
    let [_, n] = quaternions.dims();
    let plus: [Tensor<2>; 4] = std::array::from_fn(|k| quaternions.clone().narrow(0, k, 1));
    let minus = plus.clone().map(Tensor::neg);
    let entry = |place: i8| {
        let of = if place > 0 { &plus } else { &minus };
        of[usize::from(place.unsigned_abs()) - 1].clone()
    };
    let entries = layout.iter().rev().flat_map(|row| row.iter().rev()).map(|&place| entry(place)).collect();
    Tensor::cat(entries, 0).reshape([4, 4, n])
}
