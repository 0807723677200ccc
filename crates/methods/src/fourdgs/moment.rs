//! 4D Gaussians conditioned on a time, with their marginals.

use burn::tensor::Tensor;

/// Minimum variance along time; a shorter Gaussian vanishes at all times but its own, and infinities are avoided.
const MIN_VARIANCE: f32 = 1e-12;
/// Rows and columns of the entries of a covariance, in the order of [`volseggs_kernels::splat::CovarianceInputs`].
const ENTRIES: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];

/// N 4D Gaussians at a time t.
///
/// With the 4D covariance in blocks, `A` of space, `b` of space by time and `c` of time, a Gaussian at t is
/// three-dimensional: 4DGS's conditional distribution in space and marginal distribution in time.
#[derive(Clone, Debug)]
pub struct ConditionalGaussians {
    /// `mu + b / c (t - mu_t)` `[N, 3]`.
    pub means: Tensor<2>,
    /// `A - b b^T / c` by entries xx, xy, xz, yy, yz, zz `[N, 6]`.
    pub covariances: Tensor<2>,
    /// Displacement of the means per unit of time, `b / c` `[N, 3]`.
    pub velocities: Tensor<2>,
    /// Natural logarithm of the density along time, 1 at its peak: `-(t - mu_t)^2 / (2 c)` `[N]`.
    pub log_marginals: Tensor<1>,
}

impl ConditionalGaussians {
    /// Conditions Gaussians at `means` `[N, 3]` and `times` `[N]`, with `rotations` `[4, 4, N]` and the logarithms of
    /// their standard deviations along x, y, z, t `[N, 4]`, on `time`.
    pub(super) fn new(
        means: Tensor<2>,
        times: Tensor<1>,
        rotations: Tensor<3>,
        log_scales: Tensor<2>,
        time: f32,
    ) -> Self {
        let [n, _] = means.dims();
        // Sigma = M M^T with M = R S, whose first three rows are of space and the last of time
        let m = rotations * log_scales.transpose().exp().reshape([1, 4, n]);
        let (space, along) = (m.clone().narrow(0, 0, 3), m.narrow(0, 3, 1));
        let variance = (along.clone() * along.clone()).sum_dim(1).clamp_min(MIN_VARIANCE);
        let velocities = (space.clone() * along.clone()).sum_dim(1) / variance.clone();
        // A - b b^T / c = P P^T with P = M_space - (b / c) m_time^T: a product is positive semi-definite in f32 as
        // well, unlike a difference of nearly equal matrices, as for a small, fast Gaussian
        let p = space - velocities.clone() * along;
        let rows: [Tensor<3>; 3] = std::array::from_fn(|k| p.clone().narrow(0, k, 1));
        let entries = ENTRIES.map(|(a, b)| (rows[a].clone() * rows[b].clone()).sum_dim(1).reshape([1, n]));
        let velocities = velocities.reshape([3, n]).transpose();
        let since = times.neg() + time;
        let log_marginals = since.clone() * since.clone() / (variance.reshape([n]) * -2.0);
        Self {
            means: means + velocities.clone() * since.reshape([n, 1]),
            covariances: Tensor::cat(entries.to_vec(), 0).transpose(),
            velocities,
            log_marginals,
        }
    }
}
