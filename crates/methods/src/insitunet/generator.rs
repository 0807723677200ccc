//! The generator: maps a time and a view direction to an image.

use super::layers::{BatchMoments, BatchNorm, SamePaddedConv, doubled, orthogonal_layer};
use crate::insitunet::InSituNetConfig;
use crate::layers::parameter;
use burn::module::{Module, Param};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};
use volseggs_base::memory::product;
use volseggs_base::rng::Rng;
use volseggs_core::model::encoder::implicit::Layer;

/// Number of values in each group of inputs: the time; the view direction.
pub const GROUPS: [usize; 2] = [1, 3];

/// Side length in pixels at the first convolution.
const FIRST_SIDE: usize = 4;
/// Red, green and blue.
const COLOURS: usize = 3;

/// Two layers per group of inputs; the outputs of the groups are concatenated.
#[derive(Module, Debug)]
pub struct InputEncoder {
    groups: Vec<[Layer; 2]>,
}

impl InputEncoder {
    /// Creates an encoder for groups of the given sizes, with `width` outputs each.
    pub fn new(groups: &[usize], width: usize, rng: &mut Rng, device: &Device) -> Self {
        let mut group = |inputs: usize| [inputs, width].map(|n| orthogonal_layer(rng, [n, width], device));
        Self { groups: groups.iter().map(|inputs| group(*inputs)).collect() }
    }

    /// Maps `[N, sum of the groups]` to `[N, groups * width]`.
    pub fn forward(&self, inputs: Tensor<2>) -> Tensor<2> {
        self.forward_with(inputs, &mut |layer| layer.weight.val())
    }

    /// As [`InputEncoder::forward`], with the weights that `weight` computes from a layer.
    pub fn forward_with(&self, inputs: Tensor<2>, weight: &mut dyn FnMut(&Layer) -> Tensor<2>) -> Tensor<2> {
        let mut column = 0;
        let mut parts = Vec::with_capacity(self.groups.len());
        for group in &self.groups {
            let [n, _] = group[0].weight.dims();
            let mut x = inputs.clone().narrow(1, column, n);
            for layer in group {
                x = relu(burn::tensor::module::linear(x, weight(layer), Some(layer.bias.val())));
            }
            parts.push(x);
            column += n;
        }
        Tensor::cat(parts, 1)
    }

    /// All layers, in the order in which [`InputEncoder::forward_with`] requests them.
    pub fn layers(&self) -> impl Iterator<Item = &Layer> {
        self.groups.iter().flatten()
    }
}

/// A residual block that doubles the side length.
#[derive(Module, Debug)]
pub struct UpBlock {
    norms: [BatchNorm; 2],
    convs: [SamePaddedConv; 2],
    skip: SamePaddedConv,
}

impl UpBlock {
    fn new([inputs, outputs]: [usize; 2], rng: &mut Rng, device: &Device) -> Self {
        Self {
            norms: [inputs, outputs].map(|n| BatchNorm::new(n, device)),
            convs: [inputs, outputs].map(|n| SamePaddedConv::new(rng, [n, outputs], 3, false, device)),
            skip: SamePaddedConv::new(rng, [inputs, outputs], 1, false, device),
        }
    }

    fn forward(&self, x: Tensor<4>, mut seen: Option<&mut Vec<BatchMoments>>) -> Tensor<4> {
        let [first, second] = &self.norms;
        let inner = relu(first.forward(x.clone(), seen.as_deref_mut()));
        let inner = self.convs[0].forward(doubled(inner));
        let inner = self.convs[1].forward(relu(second.forward(inner, seen)));
        inner + self.skip.forward(doubled(x))
    }
}

/// Maps the inputs to an image of `4 * 2^blocks` pixels.
#[derive(Module, Debug)]
pub struct Generator {
    encoder: InputEncoder,
    /// `[groups * width, channels * 4 * 4]`, without biases.
    dense: Param<Tensor<2>>,
    blocks: Vec<UpBlock>,
    norm: BatchNorm,
    colour: SamePaddedConv,
}

/// Numbers of the generator's trained values and of its statistics; saturates.
pub fn parameters(config: &InSituNetConfig, groups: &[usize]) -> [u128; 2] {
    let wide = |n: usize| n as u128;
    let all = |terms: &[u128]| terms.iter().fold(0u128, |sum, term| sum.saturating_add(*term));
    let of = |factors: &[u128]| factors.iter().fold(1u128, |product, factor| product.saturating_mul(*factor));
    let e = wide(config.encoder);
    let encoder =
        groups.iter().fold(0, |sum: u128, n| sum.saturating_add(all(&[of(&[wide(*n), e]), e, of(&[e, e]), e])));
    let channels = &config.channels;
    let (first, last) = (channels.first().copied().unwrap_or(0), channels.last().copied().unwrap_or(0));
    let dense = of(&[wide(groups.len()), e, wide(first), wide(FIRST_SIDE * FIRST_SIDE)]);
    let (mut blocks, mut statistics) = (0u128, of(&[2, wide(last)]));
    for pair in channels.windows(2) {
        let (i, o) = (wide(pair[0]), wide(pair[1]));
        let norms = all(&[of(&[2, i]), of(&[2, o])]);
        let convs = all(&[of(&[9, i, o]), of(&[9, o, o]), of(&[i, o])]);
        (blocks, statistics) = (all(&[blocks, norms, convs]), statistics.saturating_add(norms));
    }
    let colour = all(&[of(&[2, wide(last)]), of(&[9, wide(last), wide(COLOURS)]), wide(COLOURS)]);
    [all(&[encoder, dense, blocks, colour]), statistics]
}

/// Number of values of the images between the blocks for one image, one per block; saturates.
pub(super) fn image_values(config: &InSituNetConfig) -> u128 {
    let of = |(k, channels): (usize, &usize)| product(&[FIRST_SIDE << k, FIRST_SIDE << k, *channels]);
    config.channels.iter().enumerate().map(of).fold(0, u128::saturating_add)
}

impl Generator {
    /// A generator with orthogonal weights.
    pub fn new(config: &InSituNetConfig, groups: &[usize], rng: &mut Rng, device: &Device) -> Self {
        let channels = &config.channels;
        let (first, last) = (channels.first().copied().unwrap_or(1), channels.last().copied().unwrap_or(1));
        let encoder = InputEncoder::new(groups, config.encoder, rng, device);
        let (inputs, outputs) = (groups.len() * config.encoder, first * FIRST_SIDE * FIRST_SIDE);
        let dense = parameter(super::layers::orthogonal(rng, inputs, outputs), [inputs, outputs], device);
        Self {
            encoder,
            dense,
            blocks: channels.windows(2).map(|pair| UpBlock::new([pair[0], pair[1]], rng, device)).collect(),
            norm: BatchNorm::new(last, device),
            colour: SamePaddedConv::new(rng, [last, COLOURS], 3, true, device),
        }
    }

    /// The device of its weights.
    pub fn device(&self) -> Device {
        self.dense.device()
    }

    /// Images `[N, 3, side, side]` in [-1, 1] for inputs `[N, 4]`. In training (`seen` is given) a batch is normalised
    /// by its own moments, which are appended to `seen`.
    pub fn forward(&self, inputs: Tensor<2>, mut seen: Option<&mut Vec<BatchMoments>>) -> Tensor<4> {
        let n = inputs.dims()[0];
        let x = self.encoder.forward(inputs).matmul(self.dense.val());
        let channels = x.dims()[1] / (FIRST_SIDE * FIRST_SIDE);
        let mut x = x.reshape([n, channels, FIRST_SIDE, FIRST_SIDE]);
        for block in &self.blocks {
            x = block.forward(x, seen.as_deref_mut());
        }
        self.colour.forward(relu(self.norm.forward(x, seen))).tanh()
    }

    /// Updates the statistics with the moments of a batch, in the order in which [`Generator::forward`] returned them.
    pub fn renew(&mut self, seen: Vec<BatchMoments>) {
        let norms = self.blocks.iter_mut().flat_map(|block| &mut block.norms).chain([&mut self.norm]);
        norms.zip(seen).for_each(|(norm, moments)| norm.renew(moments));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::insitunet::layers::STATISTICS;
    use crate::insitunet::resize::resized;
    use crate::test_support::{Reference, device};
    use volseggs_base::rng::Purpose;
    use volseggs_core::model::params::{self, to_vec};

    #[test]
    fn it_is_as_large_as_the_published_one() {
        // counted from the published code for images of 256x256: inputs in groups of 1, 3 and 3
        let channels = vec![1024, 1024, 512, 512, 256, 128, 64];
        let published = InSituNetConfig { channels, ..InSituNetConfig::default() };
        assert_eq!(parameters(&published, &[1, 3, 3])[0], 60_972_995);
        let config = InSituNetConfig { channels: vec![6, 5, 4], encoder: 7, ..InSituNetConfig::default() };
        let generator = Generator::new(&config, &GROUPS, &mut Rng::new(1, 0, Purpose::Custom(0)), &device());
        let is_statistic = |name: &str| STATISTICS.iter().any(|end| name.ends_with(end));
        let sizes = params::sizes(&generator);
        let held =
            |of: bool| sizes.iter().filter(|(n, _)| is_statistic(n) == of).map(|(_, n)| *n as u128).sum::<u128>();
        assert_eq!(parameters(&config, &GROUPS), [held(false), held(true)]);
    }

    #[test]
    fn onnx_runtime_gives_the_same_pictures() {
        let reference = Reference::read("generator");
        let config = InSituNetConfig { channels: vec![6, 4, 3], encoder: 5, ..InSituNetConfig::default() };
        let generator = Generator::new(&config, &GROUPS, &mut Rng::new(1, 0, Purpose::Custom(0)), &device());
        let generator = params::load(generator, &reference.0).unwrap();
        reference.check("training", generator.forward(reference.input("inputs"), Some(&mut Vec::new())));
        let drawn = generator.forward(reference.input("inputs"), None);
        reference.check("drawing", drawn.clone());
        reference.check("resized", resized(drawn, [11, 13]));
    }

    #[test]
    fn pictures_have_the_side_of_the_blocks_and_know_their_inputs() {
        let config = InSituNetConfig { channels: vec![6, 5, 4], encoder: 7, ..InSituNetConfig::default() };
        let mut generator = Generator::new(&config, &GROUPS, &mut Rng::new(1, 0, Purpose::Custom(0)), &device());
        let inputs = Tensor::<2>::from_floats([[0.1, 1.0, 0.0, 0.2], [0.9, 0.0, 1.0, -0.3]], &device());
        let mut seen = Vec::new();
        let picture = generator.forward(inputs.clone(), Some(&mut seen));
        assert_eq!((picture.dims(), seen.len(), config.side()), ([2, 3, 16, 16], 5, 16));
        let values = to_vec(picture);
        assert!(values.iter().all(|v| v.abs() <= 1.0) && values[..768] != values[768..]);
        // after many identical batches the statistics are those of the batch, except that variances are sample
        // variances
        let before = to_vec(generator.forward(inputs.clone(), None));
        for _ in 0..100 {
            let mut seen = Vec::new();
            let _ = generator.forward(inputs.clone(), Some(&mut seen));
            generator.renew(seen);
        }
        let after = to_vec(generator.forward(inputs, None));
        let off = |a: &[f32]| a.iter().zip(&values).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(off(&after) < 0.05 && off(&before) > 2.0 * off(&after), "{} {}", off(&before), off(&after));
    }
}
