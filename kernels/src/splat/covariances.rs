//! Splatting of Gaussians whose covariances are given entry by entry, not by a rotation and scales: the result of
//! taking a higher-dimensional Gaussian at a given time, or of a linear map of a Gaussian.

use super::{CovarianceTensors, SplatOutput, SplatSettings, SplatTensors, check_common, offsets_or_zeros, render};
use burn::backend::Dispatch;
use burn::tensor::Tensor;

/// N Gaussians on a device with explicit covariances, as drawn by [`splat_covariances`]. They have no axes of their
/// own, so [`crate::shading`] does not apply to them.
#[derive(Clone, Debug)]
pub struct CovarianceInputs {
    /// World positions `[N, 3]`.
    pub means: Tensor<2>,
    /// Entries xx, xy, xz, yy, yz, zz of the symmetric covariances `[N, 6]`, scene units squared. Compute them as
    /// products `M M^T`: a difference of matrices may be indefinite through rounding, and such a Gaussian is culled.
    /// The gradient with respect to an off-diagonal entry counts both of its positions.
    pub covariances: Tensor<2>,
    /// Opacity before the sigmoid `[N]`.
    pub opacity_logits: Tensor<1>,
    /// Spherical-harmonics coefficients `[N, K, 3]`, K in 1, 4, 9, 16, or 6, 15 of even bands.
    pub sh: Tensor<3>,
    /// As [`super::SplatInputs::screen_offsets`] `[N, 2]`.
    pub screen_offsets: Option<Tensor<2>>,
}

impl CovarianceInputs {
    /// Converts the inputs to the tensors that the backends take.
    pub fn into_tensors(self) -> SplatTensors<Dispatch> {
        SplatTensors {
            screen_offsets: offsets_or_zeros(self.screen_offsets, &self.means).into_dispatch(),
            means: self.means.into_dispatch(),
            covariances: CovarianceTensors::Entries(self.covariances.into_dispatch()),
            opacity_logits: self.opacity_logits.into_dispatch(),
            sh: self.sh.into_dispatch(),
        }
    }
}

/// As [`super::splat`], for Gaussians with explicit covariances. One whose covariance is not finite or not positive
/// semi-definite (see [`super::MINOR_SLACK`]) is culled.
///
/// # Panics
/// As [`super::splat`].
pub fn splat_covariances(inputs: CovarianceInputs, settings: SplatSettings) -> SplatOutput {
    let n = inputs.means.dims()[0];
    assert_eq!(inputs.covariances.dims(), [n, 6], "splat: covariances are [N, 6] with N = {n}");
    assert!(settings.rendering.path_opacity == 0.0, "splat: path_opacity needs rotations and scales, not covariances");
    check_common(&inputs.means, &inputs.opacity_logits, &inputs.sh, inputs.screen_offsets.as_ref(), &settings);
    render(inputs.into_tensors(), settings)
}
