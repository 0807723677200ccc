//! The network: residual blocks of sines.

use crate::coordnet::CoordNetConfig;
use crate::layers::{layer, pytorch_bound};
use burn::module::Module;
use burn::tensor::{Device, Tensor};
use volseggs_base::memory::product;
use volseggs_base::rng::{Purpose, Rng};
use volseggs_core::model::encoder::implicit::Layer;
use volseggs_kernels::sine::sine;

/// Inputs per pixel: horizontal and vertical position, polar angle, azimuth and time, each in [-1, 1].
pub const INPUTS: usize = 5;
/// Red, green and blue, each in [-1, 1].
pub const OUTPUTS: usize = 3;

/// A residual block, `(S2(S1(x)) + x) / 2` with `S(x) = sin(omega (x W + b))`. If it changes the width, a third layer
/// `S3(x)` replaces x in the sum.
#[derive(Module, Debug)]
pub struct ResidualBlock {
    first: Layer,
    second: Layer,
    skip: Option<Layer>,
}

impl ResidualBlock {
    fn new(rng: &mut Rng, [inputs, outputs]: [usize; 2], omega: f64, device: &Device) -> Self {
        let mut new = |inputs: usize| {
            let bound = weight_bound(inputs, omega);
            layer(rng, [inputs, outputs], bound, pytorch_bound(inputs), device)
        };
        let (first, second) = (new(inputs), new(outputs));
        Self { first, second, skip: (inputs != outputs).then(|| new(inputs)) }
    }

    fn forward(&self, x: Tensor<2>, omega: f32) -> Tensor<2> {
        let sine = |x: Tensor<2>, layer: &Layer| sine(x.matmul(layer.weight.val()), layer.bias.val(), omega);
        let inner = sine(sine(x.clone(), &self.first), &self.second);
        let skip = match &self.skip {
            Some(layer) => sine(x, layer),
            None => x,
        };
        (inner + skip).mul_scalar(0.5)
    }
}

/// Bound of the initial weights, which are uniform around zero: `sqrt(6 / inputs) / omega` (Sitzmann et al., "Implicit
/// neural representations with periodic activation functions", NeurIPS 2020, section 3.2), so that the input of each
/// sine varies by about 1 at any depth. Their first layer has the bound `1 / inputs`; CoordNet uses one rule for all
/// layers.
fn weight_bound(inputs: usize, omega: f64) -> f64 {
    (6.0 / inputs as f64).sqrt() / omega
}

/// All blocks: those that widen the input, those of constant width, and one that outputs the colour.
#[derive(Module, Debug)]
pub struct SineNetwork {
    blocks: Vec<ResidualBlock>,
    #[module(skip)]
    omega: f32,
}

/// Inputs and outputs of every block.
fn sizes(config: &CoordNetConfig) -> impl Iterator<Item = [usize; 2]> {
    let last = config.widths.last().copied().unwrap_or(INPUTS);
    let widths = config.widths.iter().copied().chain(std::iter::repeat_n(last, config.blocks)).chain([OUTPUTS]);
    widths.scan(INPUTS, |inputs, outputs| {
        let size = [*inputs, outputs];
        *inputs = outputs;
        Some(size)
    })
}

/// Number of weights and biases of the network; saturates.
pub fn parameters(config: &CoordNetConfig) -> u128 {
    let of = |[inputs, outputs]: [usize; 2]| {
        let layer = |inputs: usize| product(&[inputs, outputs]).saturating_add(outputs as u128);
        let skip = if inputs == outputs { 0 } else { layer(inputs) };
        layer(inputs).saturating_add(layer(outputs)).saturating_add(skip)
    };
    sizes(config).map(of).fold(0, u128::saturating_add)
}

/// Total number of hidden values per pixel in all layers; saturates.
pub(super) fn values_per_pixel(config: &CoordNetConfig) -> u128 {
    let of = |[inputs, outputs]: [usize; 2]| product(&[outputs, if inputs == outputs { 2 } else { 3 }]);
    sizes(config).map(of).fold(0, u128::saturating_add)
}

impl SineNetwork {
    /// A network with random weights.
    pub fn new(config: &CoordNetConfig, seed: u64, device: &Device) -> Self {
        let mut rng = Rng::new(seed, 0, Purpose::MethodInit);
        let blocks = sizes(config).map(|size| ResidualBlock::new(&mut rng, size, config.omega, device)).collect();
        Self { blocks, omega: config.omega as f32 }
    }

    /// The device of its weights.
    pub fn device(&self) -> Device {
        match self.blocks.first() {
            Some(block) => block.first.weight.device(),
            None => unreachable!("there is always a block that outputs the colour"),
        }
    }

    /// Colours `[N, 3]` in [-1, 1] for inputs `[N, 5]`. There is no final linear layer: the last block also consists of
    /// sines.
    pub fn forward(&self, inputs: Tensor<2>) -> Tensor<2> {
        self.blocks.iter().fold(inputs, |x, block| block.forward(x, self.omega))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layers::{parameter, uniform};
    use crate::test_support::{Reference, device};
    use volseggs_core::model::params;

    #[test]
    fn it_is_as_large_as_the_published_one() {
        // counted from the layers of the published code with five inputs: 5.67 MiB, the VolSegGS paper's table has 5.71
        assert_eq!(parameters(&CoordNetConfig::default()), 1_487_314);
        let config = CoordNetConfig { widths: vec![8, 12], blocks: 2, ..CoordNetConfig::default() };
        let held: usize = params::sizes(&SineNetwork::new(&config, 0, &device())).values().sum();
        assert_eq!(parameters(&config), held as u128);
    }

    #[test]
    fn onnx_runtime_gives_the_same_colours() {
        let reference = Reference::read("coordnet");
        let config = CoordNetConfig { widths: vec![6, 9], blocks: 2, ..CoordNetConfig::default() };
        let network = params::load(SineNetwork::new(&config, 0, &device()), &reference.0).unwrap();
        reference.check("colours", network.forward(reference.input("inputs")));
    }

    #[test]
    fn a_block_is_its_formula() {
        let device = device();
        let new = |weight: Vec<f32>, shape: [usize; 2], bias: Vec<f32>| Layer {
            weight: parameter(weight, shape, &device),
            bias: parameter(bias, [shape[1]], &device),
        };
        let (w1, b1) = ([[0.02, -0.01, 0.03], [0.01, 0.04, -0.02]], [0.1, -0.2, 0.05]);
        let (w2, b2) = ([[0.03, 0.01, 0.0], [-0.02, 0.01, 0.02], [0.01, -0.03, 0.02]], [0.0, 0.1, -0.1]);
        let flat = |rows: &[[f64; 3]]| rows.iter().flatten().map(|v| *v as f32).collect::<Vec<_>>();
        let short = |bias: [f64; 3]| bias.map(|v| v as f32).to_vec();
        let block = ResidualBlock {
            first: new(flat(&w1), [2, 3], short(b1)),
            second: new(flat(&w2), [3, 3], short(b2)),
            skip: Some(new(flat(&w1), [2, 3], short(b2))),
        };
        let sine = |x: &[f64], w: &[[f64; 3]], b: [f64; 3]| -> Vec<f64> {
            let sum = |c: usize| x.iter().zip(w).map(|(x, row)| x * row[c]).sum::<f64>() + b[c];
            (0..3).map(|c| (30.0 * sum(c)).sin()).collect()
        };
        let x = [0.7, -0.4];
        let inner = sine(&sine(&x, &w1, b1), &w2, b2);
        let skip = sine(&x, &w1, b2);
        let input = Tensor::<2>::from_floats([[0.7, -0.4]], &device);
        let found = params::to_vec(block.forward(input, 30.0));
        for c in 0..3 {
            let expected = 0.5 * (inner[c] + skip[c]);
            assert!((f64::from(found[c]) - expected).abs() < 1e-5, "{c}: {} {expected}", found[c]);
        }
    }

    #[test]
    fn arguments_of_sines_have_the_published_variance() {
        // The argument of a sine has twice the variance of its layer's input. Inputs that are uniform in [-1, 1] have
        // variance 1/3; the sine of a normal distribution of variance v has (1 - exp(-2 v)) / 2.
        let (device, width, n) = (device(), 256, 512);
        let mut rng = Rng::new(5, 0, Purpose::Custom(1));
        let mut x = parameter(uniform(&mut rng, n * width, 1.0), [n, width], &device).val();
        let mut expected = 2.0 / 3.0;
        for depth in 0..4 {
            let layer = layer(&mut rng, [width, width], weight_bound(width, 30.0), 0.0, &device);
            let argument = x.matmul(layer.weight.val()).mul_scalar(30.0);
            let variance = f64::from(argument.clone().square().mean().into_scalar::<f32>());
            assert!((variance - expected).abs() < 0.04, "{depth}: {variance}, expected {expected}");
            x = argument.sin();
            expected = 1.0 - (-2.0 * expected).exp();
        }
        let bound = weight_bound(256, 30.0);
        assert!((bound - 0.005_103_1).abs() < 1e-7, "{bound}");
        let config = CoordNetConfig { widths: vec![256], blocks: 0, ..CoordNetConfig::default() };
        let tensors = params::collect(&SineNetwork::new(&config, 3, &device));
        let largest = |name: &str| tensors[name].values.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        let second = f64::from(largest("blocks.0.second.weight"));
        assert!(second <= bound && second > 0.99 * bound, "{second}");
        let first = f64::from(largest("blocks.0.first.weight"));
        let bound = weight_bound(INPUTS, 30.0);
        assert!(first <= bound && first > 0.98 * bound, "{first}: the first layer follows the same rule");
    }
}
