//! The loss function (the paper's equations 5 to 8). To add a term, write a function of tensors here, a weight in
//! `config::types::LossConfig`, and add it in `Trainer::loss`; or register it, see `volseggs::extend`.

use super::loss_term::{LossInput, LossTerm, find_loss_term};
use crate::config::types::{LossConfig, LossKind, TvOrder, TvReduction};
use crate::model::encoder::Encoder;
use crate::registry::NotRegistered;
use burn::tensor::Tensor;
use burn::tensor::activation::sigmoid;
use std::sync::Arc;
use volseggs_kernels::photometric::{Distance, Photometric, photometric_loss};
use volseggs_kernels::splat::SplatInputs;
use volseggs_kernels::ssim::mean_ssim;
use volseggs_kernels::tv::{self, TvKind, TvWeights, total_variation};

/// Returns the distance in colour and alpha: mean over pixels and colour channels of the squared (`l2`, the paper's
/// equation 5) or absolute difference, plus `alpha` times the same for the alpha channel; and the mean squared
/// difference of the colours, for PSNR. `loss.weight` is not included.
///
/// `image` and `target` are `[H, W, 4]`.
pub fn photometric(image: Tensor<3>, target: Tensor<3>, config: &LossConfig) -> Photometric {
    let kind = match config.kind {
        LossKind::L1 => Distance::Absolute,
        LossKind::L2 => Distance::Squared,
    };
    photometric_loss(image, target, kind, config.alpha as f32)
}

/// Returns `1 - SSIM` of the colours (equation 7), `[1]`. `image` and `target` are `[H, W, 4]`.
pub fn dssim(image: Tensor<3>, target: Tensor<3>) -> Tensor<1> {
    mean_ssim(image, target).neg().add_scalar(1.0)
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
            TvReduction::Mean => tv::TvReduction::Mean,
            TvReduction::Sum => tv::TvReduction::Sum,
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
        Encoder::Implicit(_) | Encoder::Extra(_) | Encoder::D3dgs(_) => None,
    }
}

/// Returns how much the Gaussians fade: the mean absolute difference between their opacity at a time and the canonical
/// one, in [0, 1]. Both are logits `[N]`; the result is `[1]`. This term is this project's own: images alone do not
/// distinguish an object that moves from one that fades out while another appears.
pub fn fading(at: Tensor<1>, canonical: Tensor<1>) -> Tensor<1> {
    (sigmoid(at) - sigmoid(canonical)).abs().mean()
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

/// The registered loss terms that a configuration requests, with their weights.
#[derive(Clone, Default)]
pub struct ExtraTerms(Vec<(String, f32, Arc<dyn LossTerm>)>);

impl ExtraTerms {
    /// Returns the terms of `loss.extra`, in the order of their names; those of weight 0 are skipped.
    ///
    /// # Errors
    /// The first name that is not registered, whatever its weight.
    pub fn new(config: &LossConfig) -> Result<Self, NotRegistered> {
        let find = |(name, weight): (&String, &f64)| Ok((name.clone(), *weight as f32, find_loss_term(name)?));
        let mut terms = config.extra.iter().map(find).collect::<Result<Vec<_>, _>>()?;
        terms.retain(|(_, weight, _)| *weight != 0.0);
        Ok(Self(terms))
    }

    /// Returns a copy of the Gaussians at a time, for the terms; `None` if there are no terms.
    pub fn keep(&self, at: &SplatInputs) -> Option<SplatInputs> {
        (!self.0.is_empty()).then(|| at.clone())
    }

    /// Returns `loss` with every term added.
    pub fn add_to(&self, loss: Tensor<1>, input: &LossInput<'_>) -> Tensor<1> {
        self.0.iter().fold(loss, |sum, (_, weight, term)| sum + term.loss(input).mul_scalar(*weight))
    }
}

impl std::fmt::Debug for ExtraTerms {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_map().entries(self.0.iter().map(|(name, weight, _)| (name, weight))).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::types::Config;
    use crate::model::params::to_vec;

    #[test]
    fn fading_is_the_mean_change_of_opacity_and_goes_down_by_either() {
        let device = crate::device::DeviceName::all()[0].open().unwrap().autodiff();
        let logits = |v: [f32; 3]| Tensor::<1>::from_floats(v, &device).require_grad();
        let (at, canonical) = (logits([0.0, 2.0, -8.0]), logits([1.0, 2.0, 3.0]));
        let loss = fading(at.clone(), canonical.clone());
        let sigmoid = |x: f32| 1.0 / (1.0 + (-x).exp());
        let expected = ((sigmoid(1.0) - 0.5) + (sigmoid(3.0) - sigmoid(-8.0))) / 3.0;
        assert!((to_vec(loss.clone().inner())[0] - expected).abs() < 1e-6);
        let gradients = loss.backward();
        let of = |t: &Tensor<1>| to_vec(t.grad(&gradients).unwrap());
        let slope = |x: f32| sigmoid(x) * (1.0 - sigmoid(x)) / 3.0;
        for (found, expected) in
            [(of(&at), [-slope(0.0), 0.0, -slope(-8.0)]), (of(&canonical), [slope(1.0), 0.0, slope(3.0)])]
        {
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?}, not {expected:?}");
        }
    }

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
