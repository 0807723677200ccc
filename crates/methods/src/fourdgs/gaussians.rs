//! N trainable Gaussians in space and time, and what is drawn of them.

use super::rotation::rotations;
use super::{ConditionalGaussians, harmonics_at};
use burn::module::{Module, Param};
use burn::tensor::Tensor;
use burn::tensor::activation::{log_sigmoid, sigmoid};
use volseggs_kernels::splat::CovarianceInputs;

/// Gaussians whose marginal at a time is at most this are not drawn, as in the official code.
const MIN_MARGINAL: f32 = 0.05;
/// The logit of a vanishing opacity.
const TRANSPARENT: f32 = -1e4;
/// Minimum transmittance, so that its logarithm is finite.
const MIN_TRANSMITTANCE: f32 = 1e-30;

/// N Gaussians in space and time.
#[derive(Module, Debug)]
pub struct Gaussians4d {
    /// World positions `[N, 3]`.
    pub means: Param<Tensor<2>>,
    /// Times of their peaks `[N]`.
    pub times: Param<Tensor<1>>,
    /// Natural logarithms of the standard deviations along x, y, z (scene units) and t `[N, 4]`, before the rotation.
    pub log_scales: Param<Tensor<2>>,
    /// Left quaternions of the rotations (w, i, j, k) `[N, 4]`, see [`super::rotation_matrices`].
    pub left: Param<Tensor<2>>,
    /// Right quaternions `[N, 4]`.
    pub right: Param<Tensor<2>>,
    /// Opacity at the peak before the sigmoid `[N]`.
    pub opacity_logits: Param<Tensor<1>>,
    /// Spherindrical-harmonics coefficients `[N, O K, 3]`: K for each of O orders in time, see [`harmonics_at`].
    pub sh: Param<Tensor<3>>,
}

/// Extent of the colour series.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColourSeries {
    /// Directional coefficients per order in time, K: 1, 4, 9 or 16.
    pub sh_stride: usize,
    /// The highest order in time in use; higher ones are ignored and get no gradient.
    pub time_degree: usize,
    /// Duration after which the first order repeats, T.
    pub duration: f32,
}

impl Gaussians4d {
    /// Returns what is drawn at `time`: [`ConditionalGaussians`], the opacity times its marginal, colours by
    /// [`harmonics_at`]. Gradients are kept if the parameters have them.
    ///
    /// # Panics
    /// As [`harmonics_at`].
    pub fn at_time(&self, time: f32, colours: ColourSeries) -> CovarianceInputs {
        self.drawn(self.moment(time), time, colours)
    }

    /// As [`Gaussians4d::at_time`], with the result of [`Gaussians4d::moment`] for that time.
    ///
    /// # Panics
    /// As [`harmonics_at`].
    pub fn drawn(&self, moment: ConditionalGaussians, time: f32, colours: ColourSeries) -> CovarianceInputs {
        let ColourSeries { sh_stride, time_degree, duration } = colours;
        CovarianceInputs {
            means: moment.means,
            covariances: moment.covariances,
            opacity_logits: faded(self.opacity_logits.val(), moment.log_marginals),
            sh: harmonics_at(self.sh.val(), self.times.val(), sh_stride, time_degree, time, duration),
            screen_offsets: None,
        }
    }

    /// Positions, extents, velocities and marginals of the Gaussians at `time`.
    pub fn moment(&self, time: f32) -> ConditionalGaussians {
        let rotations = rotations(self.left.val(), self.right.val());
        ConditionalGaussians::new(self.means.val(), self.times.val(), rotations, self.log_scales.val(), time)
    }

    /// Number of Gaussians.
    pub fn count(&self) -> usize {
        self.times.dims()[0]
    }
}

/// The logits of opacities (given as logits) times marginals (given as logarithms); all `[N]`.
fn faded(logits: Tensor<1>, log_marginals: Tensor<1>) -> Tensor<1> {
    let gone = log_marginals.clone().lower_equal_elem(MIN_MARGINAL.ln());
    // 1 - o m = (1 - o) + o (1 - m), which avoids cancellation
    let lost = 1.0 - log_marginals.clone().exp();
    let passed: Tensor<1> = sigmoid(logits.clone().neg()) + sigmoid(logits.clone()) * lost;
    let faded = log_sigmoid(logits) + log_marginals - passed.clamp_min(MIN_TRANSMITTANCE).log();
    faded.mask_fill(gone, TRANSPARENT)
}
