//! Regularisation in addition to the colour loss: density is made sparse, appearance smooth in space and time.

use super::grid::FactorisedGrid;
use super::network::VisNerfNetwork;
use burn::tensor::Tensor;
use volseggs_kernels::tv::{DifferenceReduction, TvKind, TvWeights, total_variation};

/// Weights of the regularisation terms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegularisationWeights {
    /// Weight of the absolute values of the density grid.
    pub sparsity: f64,
    /// Weight of the total variation of appearance planes.
    pub tv: f64,
    /// Weight of the total variation of time vectors.
    pub tv_time: f64,
}

/// The weighted sum of all terms, `[1]`; `None` if no weight is above 0.
pub fn regularisers(network: &VisNerfNetwork, weights: RegularisationWeights) -> Option<Tensor<1>> {
    let RegularisationWeights { sparsity: sparse, tv, tv_time } = weights;
    let mut terms = Vec::new();
    if sparse > 0.0 {
        terms.push(sparsity(&network.density).mul_scalar(sparse));
    }
    if tv > 0.0 {
        terms.push(plane_variation(&network.appearance, tv));
    }
    if tv_time > 0.0 {
        terms.extend(time_variation(&network.appearance).map(|t| t.mul_scalar(tv_time)));
    }
    terms.into_iter().reduce(|a, b| a + b)
}

/// The sum of the mean absolute values of each plane and each line, and of the time vectors' deviation from 1: `[1]`.
fn sparsity(grid: &FactorisedGrid) -> Tensor<1> {
    let (shape, channels) = (grid.shape(), grid.shape().channels);
    let planes = grid.planes.val();
    let lines = grid.lines.val();
    let mean =
        |flat: &Tensor<1>, offset: usize, nodes: usize| flat.clone().narrow(0, offset, nodes * channels).abs().mean();
    let of_planes = shape.plane_spans().into_iter().map(|s| mean(&planes, s.offset, s.height * s.width));
    let of_lines = shape.line_spans().into_iter().map(|s| mean(&lines, s.offset, s.height * s.width));
    let of_times = grid.times.val().sub_scalar(1.0).abs().mean();
    of_planes.chain(of_lines).fold(of_times, |sum, term| sum + term)
}

/// Twice the mean squared difference of neighbours on planes, along both axes, times `weight`: `[1]`.
fn plane_variation(grid: &FactorisedGrid, weight: f64) -> Tensor<1> {
    let weights = TvWeights {
        space: 2.0 * weight as f32,
        time: 0.0,
        one_prior_space: 0.0,
        one_prior_time: 0.0,
        reduction: DifferenceReduction::Mean,
    };
    let (planes, device) = (grid.planes.val(), grid.planes.val().device());
    // the op weights lines like planes; constant lines add nothing
    let lines = Tensor::zeros([grid.shape().lines_len()], &device);
    let times = Tensor::ones([grid.shape().times_len()], &device);
    total_variation(planes, lines, times, grid.shape(), TvKind::First, weights)
}

/// Twice the mean squared difference of the vectors of neighbouring times: `[1]`; `None` for a single time.
fn time_variation(grid: &FactorisedGrid) -> Option<Tensor<1>> {
    let [knots, ranks] = grid.times.dims();
    let times = grid.times.val();
    (knots > 1).then(|| {
        let (before, after) = (times.clone().slice([0..knots - 1, 0..ranks]), times.slice([1..knots, 0..ranks]));
        (after - before).square().mean().mul_scalar(2.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::device;
    use crate::visnerf::VisNerfConfig;
    use burn::module::Param;
    use volseggs_core::model::params::to_vec;

    #[test]
    fn terms_are_their_formulas() {
        let config = VisNerfConfig {
            density_ranks: 2,
            appearance_ranks: 3,
            time_ranks: 2,
            width: 8,
            ..VisNerfConfig::default()
        };
        let mut network = VisNerfNetwork::new(&config, [3, 4, 2], 3, 1, &device());
        let times = Tensor::<2>::from_floats([[0.1, 1.3], [0.4, 0.9], [1.0, 1.0]], &device());
        (network.density.times, network.appearance.times) =
            (Param::from_tensor(times.clone()), Param::from_tensor(times));
        let of = |sparsity: f64, tv: f64, tv_time: f64| {
            regularisers(&network, RegularisationWeights { sparsity, tv, tv_time }).map(|t| f64::from(to_vec(t)[0]))
        };
        assert_eq!(of(0.0, 0.0, 0.0), None);

        let wide = |p: &Param<Tensor<1>>| to_vec(p.val()).iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
        let mean = |v: &[f64]| v.iter().map(|v| v.abs()).sum::<f64>() / v.len() as f64;
        let (planes, lines) = (wide(&network.density.planes), wide(&network.density.lines));
        // xy 12 nodes, xz 6, yz 8; lines 3, 4, 2; two ranks
        let parts = mean(&planes[..24]) + mean(&planes[24..36]) + mean(&planes[36..]);
        let expected = parts + mean(&lines[..6]) + mean(&lines[6..14]) + mean(&lines[14..]);
        let expected = expected + (0.9 + 0.3 + 0.6 + 0.1) / 6.0;
        assert!((of(1.0, 0.0, 0.0).unwrap() - expected).abs() < 1e-6);

        let planes = wide(&network.appearance.planes);
        let mut expected = 0.0;
        for (offset, height, width) in [(0, 4, 3), (36, 2, 3), (54, 2, 4)] {
            let at = |y: usize, x: usize, r: usize| planes[offset + (y * width + x) * 3 + r];
            let (mut down, mut across) = (Vec::new(), Vec::new());
            for y in 0..height {
                for x in 0..width {
                    for r in 0..3 {
                        down.extend((y + 1 < height).then(|| (at(y + 1, x, r) - at(y, x, r)).powi(2)));
                        across.extend((x + 1 < width).then(|| (at(y, x + 1, r) - at(y, x, r)).powi(2)));
                    }
                }
            }
            expected += 2.0 * (mean(&down) + mean(&across));
        }
        assert!((of(0.0, 0.5, 0.0).unwrap() - 0.5 * expected).abs() < 1e-6);
        let expected = 2.0 * (0.3f64.powi(2) + 0.4f64.powi(2) + 0.6f64.powi(2) + 0.1f64.powi(2)) / 4.0;
        assert!((of(0.0, 0.0, 1.0).unwrap() - expected).abs() < 1e-6);
        let all = of(1.0, 1.0, 1.0).unwrap();
        let parts = [of(1.0, 0.0, 0.0), of(0.0, 1.0, 0.0), of(0.0, 0.0, 1.0)];
        assert!((all - parts.iter().flatten().sum::<f64>()).abs() < 1e-5);
    }
}
