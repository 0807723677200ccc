//! Colours over directions and time.

use burn::tensor::Tensor;
use std::f32::consts::TAU;

/// Spherical-harmonics coefficients `[N, K, 3]` at `time` from the spherindrical ones (4DGS) `coefficients`
/// `[N, O K, 3]`, stored by order in time from 0 to O - 1: `sum_n cos(2 pi n (mu_t - t) / T) k_n`, with `times` `[N]`,
/// the `duration` T and orders up to `time_degree`.
///
/// # Panics
/// If the coefficients do not reach that order, or their number is not a multiple of `sh_stride`.
pub fn harmonics_at(
    coefficients: Tensor<3>,
    times: Tensor<1>,
    sh_stride: usize,
    time_degree: usize,
    time: f32,
    duration: f32,
) -> Tensor<3> {
    let [n, all, _] = coefficients.dims();
    assert!(
        all.is_multiple_of(sh_stride) && all >= (time_degree + 1) * sh_stride,
        "harmonics_at: [N, {all}, 3] are not {} orders of {sh_stride}",
        time_degree + 1
    );
    let of = |order: usize| coefficients.clone().slice([0..n, order * sh_stride..(order + 1) * sh_stride, 0..3]);
    let angles = ((times - time) * (TAU / duration)).reshape([n, 1, 1]);
    (1..=time_degree).fold(of(0), |sum, order| sum + (angles.clone() * order as f32).cos() * of(order))
}
