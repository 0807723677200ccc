//! Smoothness of the field's grid in the joint stage (the paper's equation 6), `loss.tv*` and `loss.one_prior`.

use super::{LossInput, LossTerm};
use crate::config::types::{Config, LossConfig, TvOrder, TvReduction};
use crate::model::encoder::Encoder;
use crate::train::schedule::Stage;
use burn::tensor::Tensor;
use volseggs_kernels::tv::{self, TvKind, TvWeights, total_variation};

/// Total variation of the grid. Its parts have weights of their own, which its value includes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Smoothness;

impl LossTerm for Smoothness {
    fn loss(&self, seen: &LossInput<'_>) -> Tensor<1> {
        let found = smoothness(&seen.scene.field.encoder, &seen.config.loss);
        found.unwrap_or_else(|| Tensor::zeros([1], &seen.image.device()))
    }

    fn weight(&self, config: &Config, stage: Stage) -> Option<f64> {
        let is_on = stage.is_joint() && config.loss.of_the_grid().is_some();
        Some(if is_on { 1.0 } else { 0.0 })
    }
}

/// Returns the smoothness loss of the encoder, weights included; `None` if the encoder has no grid or every weight is
/// zero.
///
/// Equation 6 sums the squared differences of every tensor (`loss.tv_reduction = "sum"`); the default takes their mean
/// in each tensor, separately along each axis of a plane, and adds these up over the tensors of all levels, as the
/// reference code does. Space-time planes are smooth in space in their mean over time, and along time in each of their
/// points. `loss.one_prior` always uses the mean of each tensor.
pub fn smoothness(encoder: &Encoder, config: &LossConfig) -> Option<Tensor<1>> {
    let weights = TvWeights {
        space: config.tv as f32,
        time: config.tv_time as f32,
        one_prior_space: config.one_prior as f32,
        one_prior_time: config.one_prior as f32,
        reduction: match config.tv_reduction {
            TvReduction::Mean => tv::DifferenceReduction::Mean,
            TvReduction::Sum => tv::DifferenceReduction::Sum,
        },
    };
    let any = config.tv > 0.0 || config.tv_time > 0.0 || config.one_prior > 0.0;
    let kind = match config.tv_kind {
        TvOrder::First => TvKind::First,
        TvOrder::Second => TvKind::Second,
    };
    match encoder {
        _ if !any => None,
        Encoder::Factorised(e) => {
            Some(total_variation(e.planes.val(), e.lines.val(), e.times.val(), e.shape(), kind, weights))
        }
        Encoder::HexPlane(e) => {
            let device = e.planes.val().device();
            let space = total_variation(e.planes.val(), e.mean_lines(), e.ones(&device), e.shape(), kind, weights);
            Some(space + over_time(e.lines.val(), config))
        }
        _ => None,
    }
}

/// Returns the smoothness loss along time of space-time planes `[knots, lines]`, weighted by `loss.tv_time`.
fn over_time(planes: Tensor<2>, config: &LossConfig) -> Tensor<1> {
    let differences = |values: Tensor<2>| {
        let [knots, n] = values.dims();
        (knots > 1).then(|| values.clone().slice([1..knots, 0..n]) - values.slice([0..knots - 1, 0..n]))
    };
    let first = differences(planes.clone());
    let found = match config.tv_kind {
        TvOrder::First => first,
        TvOrder::Second => first.and_then(differences),
    };
    let Some(squares) = found.map(|d| d.clone() * d) else { return Tensor::zeros([1], &planes.device()) };
    let sum = match config.tv_reduction {
        TvReduction::Mean => squares.mean(),
        TvReduction::Sum => squares.sum(),
    };
    sum.mul_scalar(config.tv_time)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::params::to_vec;

    #[test]
    fn planes_of_time_are_smooth_by_first_or_second_differences() {
        let device = crate::device::DeviceName::all()[0].open().unwrap();
        // a line of slope 3, and a parabola
        let planes = Tensor::<2>::from_floats([[0.0, 0.0], [3.0, 1.0], [6.0, 4.0], [9.0, 9.0]], &device);
        let of = |kind, reduction| {
            let loss = &mut Config::default().loss;
            (loss.tv_kind, loss.tv_reduction, loss.tv_time) = (kind, reduction, 0.5);
            to_vec(over_time(planes.clone(), loss))[0]
        };
        let first = 3.0 * 9.0 + 1.0 + 9.0 + 25.0;
        assert_eq!(of(TvOrder::First, TvReduction::Sum), 0.5 * first);
        assert!((of(TvOrder::First, TvReduction::Mean) - 0.5 * first / 6.0).abs() < 1e-5);
        assert_eq!(of(TvOrder::Second, TvReduction::Sum), 0.5 * 8.0);
        let one = planes.slice([0..1, 0..2]);
        assert_eq!(to_vec(over_time(one, &Config::default().loss)), [0.0], "one knot has no neighbour");
    }
}
