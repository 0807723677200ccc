//! Parts shared by the networks of several methods: initial weights of layers, softplus.

use burn::module::Param;
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor, TensorData};
use volseggs_base::rng::Rng;
use volseggs_core::model::encoder::implicit::Layer;

/// `len` values, uniform in [-bound, bound].
pub(super) fn uniform(rng: &mut Rng, len: usize, bound: f64) -> Vec<f32> {
    (0..len).map(|_| (bound * f64::from(2.0 * rng.uniform() - 1.0)) as f32).collect()
}

/// A parameter of the given shape.
pub(super) fn parameter<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Param<Tensor<D>> {
    Param::from_tensor(Tensor::from_data(TensorData::new(values, shape), device))
}

/// A layer with weights uniform in [-weight, weight] and biases in [-bias, bias].
pub(super) fn layer(rng: &mut Rng, [inputs, outputs]: [usize; 2], weight: f64, bias: f64, device: &Device) -> Layer {
    Layer {
        weight: parameter(uniform(rng, inputs * outputs, weight), [inputs, outputs], device),
        bias: parameter(uniform(rng, outputs, bias), [outputs], device),
    }
}

/// PyTorch's default bound of initial weights and biases: `1 / sqrt(inputs)`.
pub(super) fn pytorch_bound(inputs: usize) -> f64 {
    1.0 / (inputs as f64).sqrt()
}

/// `ln(1 + exp(x))`, exact for large x of either sign.
pub(super) fn softplus<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    x.clone().abs().neg().exp().log1p() + relu(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::device;
    use volseggs_core::model::params::to_vec;

    #[test]
    fn softplus_never_overflows_and_keeps_small_values() {
        let x = Tensor::<1>::from_floats([-200.0, -10.0, 0.0, 3.0, 200.0], &device());
        let found = to_vec(softplus(x));
        let expected = [0.0, 4.539_889_9e-5, std::f64::consts::LN_2, 3.048_587_351_573_742, 200.0];
        for (found, expected) in found.iter().zip(expected) {
            assert!((f64::from(*found) - expected).abs() <= 1e-6 * expected, "{found} for {expected}");
        }
    }
}
