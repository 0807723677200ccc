//! The lightweight decoder: features in, changes of mean, rotation, log-scale and opacity logit out.

use crate::config::types::{BiasInit, DecoderKind, ModelConfig};
use crate::rng::{Purpose, Rng};
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use volseggs_kernels::changes::{COLUMNS, WIDTHS};
use volseggs_kernels::decoder::{DecoderShape, DecoderWeights, decoder};

/// A trunk and one or four heads, their weights packed side by side:
/// `head(relu(hidden(relu(trunk(x)))))`, each head with its own hidden layer.
#[derive(Module, Debug)]
pub struct Decoder {
    /// `[features, width]`
    pub trunk_weight: Param<Tensor<2>>,
    /// `[width]`
    pub trunk_bias: Param<Tensor<1>>,
    /// `[width, heads * width]`
    pub hidden_weight: Param<Tensor<2>>,
    /// `[heads * width]`
    pub hidden_bias: Param<Tensor<1>>,
    /// `[width, 11]`, the columns of a head fed by its hidden layer alone.
    pub output_weight: Param<Tensor<2>>,
    /// `[11]`
    pub output_bias: Param<Tensor<1>>,
    heads: usize,
}

/// `x W + b`.
pub fn linear(x: Tensor<2>, weight: &Param<Tensor<2>>, bias: &Param<Tensor<1>>) -> Tensor<2> {
    burn::tensor::module::linear(x, weight.val(), Some(bias.val()))
}

/// Xavier-uniform weights `[inputs, outputs]`.
pub fn xavier(rng: &mut Rng, inputs: usize, outputs: usize, device: &Device) -> Param<Tensor<2>> {
    let bound = (6.0 / (inputs + outputs) as f32).sqrt();
    uniform(rng, inputs, outputs, bound, device)
}

fn uniform(rng: &mut Rng, inputs: usize, outputs: usize, bound: f32, device: &Device) -> Param<Tensor<2>> {
    let values: Vec<f32> = (0..inputs * outputs).map(|_| bound * (2.0 * rng.uniform() - 1.0)).collect();
    Param::from_tensor(Tensor::from_data(TensorData::new(values, [inputs, outputs]), device))
}

impl Decoder {
    /// A new decoder for `features` inputs.
    ///
    /// With `zero_init_heads` the outputs start within 1e-4 of zero, so that the first joint step does not scatter the
    /// Gaussians; exactly zero would hold the encoder's gradient at zero for a step. Biases start as set by
    /// `bias_init`, except that those of such outputs start at zero.
    pub fn new(config: &ModelConfig, features: usize, seed: u64, device: &Device) -> Self {
        let mut rng = Rng::new(seed, 0, Purpose::DecoderInit);
        let width = config.width;
        let heads = match config.decoder {
            DecoderKind::Heads => WIDTHS.len(),
            DecoderKind::Shared => 1,
        };
        let trunk_weight = xavier(&mut rng, features, width, device);
        let hidden: Vec<Tensor<2>> = (0..heads).map(|_| xavier(&mut rng, width, width, device).val()).collect();
        let output_weight = if config.zero_init_heads {
            uniform(&mut rng, width, COLUMNS, 1e-4, device)
        } else {
            xavier(&mut rng, width, COLUMNS, device)
        };
        // drawn after the weights, which therefore do not depend on `bias_init`
        let mut bias = |inputs: usize, n: usize, is_zero: bool| {
            let bound = 1.0 / (inputs as f32).sqrt();
            let values = match config.bias_init {
                BiasInit::Uniform if !is_zero => (0..n).map(|_| bound * (2.0 * rng.uniform() - 1.0)).collect(),
                _ => vec![0.0; n],
            };
            Param::from_tensor(Tensor::from_data(TensorData::new(values, [n]), device))
        };
        Self {
            trunk_weight,
            trunk_bias: bias(features, width, false),
            hidden_weight: Param::from_tensor(Tensor::cat(hidden, 1).detach()),
            hidden_bias: bias(width, heads * width, false),
            output_weight,
            output_bias: bias(width, COLUMNS, config.zero_init_heads),
            heads,
        }
    }

    /// Maps `[N, F - E]` features, with each Gaussian's own `[N, E]` numbers beside them if given, to `[N, 11]`, fused.
    pub fn forward(&self, features: Tensor<2>, own: Option<Tensor<2>>) -> Tensor<2> {
        let [inputs, width] = self.trunk_weight.dims();
        let head_sizes = if self.heads == 1 { vec![COLUMNS] } else { WIDTHS.to_vec() };
        let weights = DecoderWeights {
            trunk: (self.trunk_weight.val(), self.trunk_bias.val()),
            hidden: (self.hidden_weight.val(), self.hidden_bias.val()),
            output: (self.output_weight.val(), self.output_bias.val()),
        };
        decoder(features, own, weights, &DecoderShape { inputs, width, head_sizes })
    }

    /// The last column of [`Self::forward`] alone, the changes of opacity logits `[N]`, without the other heads.
    pub fn opacity(&self, features: Tensor<2>, own: Option<Tensor<2>>) -> Tensor<1> {
        let [inputs, width] = self.trunk_weight.dims();
        let [n, _] = features.dims();
        let hidden = (self.heads - 1) * width..self.heads * width;
        let column = COLUMNS - 1..COLUMNS;
        let weights = DecoderWeights {
            trunk: (self.trunk_weight.val(), self.trunk_bias.val()),
            hidden: (
                self.hidden_weight.val().slice([0..width, hidden.clone()]),
                self.hidden_bias.val().slice([hidden]),
            ),
            output: (
                self.output_weight.val().slice([0..width, column.clone()]),
                self.output_bias.val().slice([column]),
            ),
        };
        decoder(features, own, weights, &DecoderShape { inputs, width, head_sizes: vec![1] }).reshape([n])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::preset;
    use crate::device::DeviceName;
    use burn::tensor::Tolerance;
    use burn::tensor::activation::relu;

    /// The same decoder in plain tensor operations.
    fn plain(decoder: &Decoder, features: Tensor<2>) -> Tensor<2> {
        let h = relu(linear(features, &decoder.trunk_weight, &decoder.trunk_bias));
        let h = relu(linear(h, &decoder.hidden_weight, &decoder.hidden_bias));
        let [n, wide] = h.dims();
        let width = wide / decoder.heads;
        let weight = decoder.output_weight.val();
        let sizes = if decoder.heads == 1 { vec![COLUMNS] } else { WIDTHS.to_vec() };
        let mut column = 0;
        let outputs = sizes.iter().enumerate().map(|(k, &size)| {
            let hidden = h.clone().slice([0..n, k * width..(k + 1) * width]);
            let part = weight.clone().slice([0..width, column..column + size]);
            column += size;
            hidden.matmul(part)
        });
        Tensor::cat(outputs.collect(), 1) + decoder.output_bias.val().unsqueeze()
    }

    #[test]
    fn biases_start_as_asked_and_leave_the_weights_alone() {
        use crate::model::params::to_vec;
        let device = DeviceName::all()[0].open().unwrap();
        let new = |bias_init, zero_init_heads| {
            let config = ModelConfig { bias_init, zero_init_heads, ..preset("best").unwrap().model };
            Decoder::new(&config, 16, 3, &device)
        };
        let biases = |d: &Decoder| [&d.trunk_bias, &d.hidden_bias, &d.output_bias].map(|b| to_vec(b.val()));
        let (plain, drawn) = (new(BiasInit::Zero, false), new(BiasInit::Uniform, false));
        assert!(biases(&plain).iter().flatten().all(|b| *b == 0.0));
        for (values, bound) in biases(&drawn).iter().zip([0.25f32, 0.125, 0.125]) {
            let largest = values.iter().fold(0.0f32, |m, b| m.max(b.abs()));
            assert!(largest <= bound && largest > 0.6 * bound, "{largest} of {bound}");
            assert!(values.iter().any(|b| *b < 0.0) && values.iter().any(|b| *b > 0.0));
        }
        assert_eq!(to_vec(plain.output_weight.val()), to_vec(drawn.output_weight.val()));
        assert!(biases(&new(BiasInit::Uniform, true))[2].iter().all(|b| *b == 0.0), "outputs start at zero");
    }

    fn the_fused_decoder_equals_plain_tensor_operations(device: Device) {
        let device = device.autodiff();
        for kind in [DecoderKind::Heads, DecoderKind::Shared] {
            let mut config = preset("best").unwrap().model;
            (config.decoder, config.zero_init_heads) = (kind, false);
            let decoder = Decoder::new(&config, 64, 3, &device);
            let mut rng = Rng::new(1, 2, Purpose::Custom(3));
            let values: Vec<f32> = (0..100 * 64).map(|_| rng.normal()).collect();
            let x = Tensor::<2>::from_data(TensorData::new(values, [100, 64]), &device).require_grad();
            let run = |out: Tensor<2>| {
                let g = (out.clone() * out.clone()).sum().backward();
                let grads = [x.grad(&g).unwrap(), decoder.hidden_weight.val().grad(&g).unwrap()];
                (out.inner().into_data(), grads.map(|t| t.into_data()))
            };
            let last = decoder.forward(x.clone(), None).slice([0..100, COLUMNS - 1..COLUMNS]).reshape([100]);
            let opacity = decoder.opacity(x.clone(), None).into_data();
            opacity.assert_approx_eq::<f32>(&last.into_data(), Tolerance::rel_abs(1e-5, 1e-6));
            let (a, ga) = run(decoder.forward(x.clone(), None));
            let (b, gb) = run(plain(&decoder, x.clone()));
            let tolerance = Tolerance::<f32>::rel_abs(1e-3, 1e-3);
            a.assert_approx_eq::<f32>(&b, tolerance);
            for (p, q) in ga.iter().zip(&gb) {
                p.assert_approx_eq::<f32>(q, tolerance);
            }
        }
    }

    volseggs_testing::on_every_device!(
        crate::device::open_to_test => the_fused_decoder_equals_plain_tensor_operations,
    );
}
