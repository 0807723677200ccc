//! The discriminator: how real an image looks for a time and a view direction.

use super::generator::{GROUPS, InputEncoder};
use super::layers::{SamePaddedConv, halved, orthogonal_layer};
use super::spectral;
use crate::insitunet::InSituNetConfig;
use crate::layers::parameter;
use burn::module::{Module, Param};
use burn::tensor::activation::relu;
use burn::tensor::module::linear;
use burn::tensor::{Device, Tensor};
use volseggs_base::rng::Rng;
use volseggs_core::model::encoder::implicit::Layer;

/// Red, green and blue.
const COLOURS: usize = 3;

/// A residual block that halves the side length; the last one keeps it.
#[derive(Module, Debug)]
struct DownBlock {
    convs: [SamePaddedConv; 2],
    skip: SamePaddedConv,
}

impl DownBlock {
    fn new([inputs, outputs]: [usize; 2], rng: &mut Rng, device: &Device) -> Self {
        Self {
            convs: [inputs, outputs].map(|n| SamePaddedConv::new(rng, [n, outputs], 3, true, device)),
            skip: SamePaddedConv::new(rng, [inputs, outputs], 1, true, device),
        }
    }

    fn all(&self) -> [&SamePaddedConv; 3] {
        [&self.convs[0], &self.convs[1], &self.skip]
    }
}

/// Maps an image and its inputs to a score, high for real images.
#[derive(Module, Debug)]
pub struct Discriminator {
    encoder: InputEncoder,
    /// Maps the encoder's output to as many values as the last block has channels.
    condition: Layer,
    /// Each halves the side length.
    blocks: Vec<DownBlock>,
    /// Keeps the side length.
    last: DownBlock,
    score: Layer,
    /// Estimates of the left singular vectors of all layers' matrices `[outputs, inputs]`, see [`spectral`]; empty
    /// without spectral normalisation. Changed only by [`Discriminator::follow`].
    left: Vec<Param<Tensor<1>>>,
}

/// Divides the matrices of layers by their largest singular value, in the order in which they are requested.
struct Normal<'a> {
    left: std::slice::Iter<'a, Param<Tensor<1>>>,
}

impl Normal<'_> {
    fn linear(&mut self, layer: &Layer) -> Tensor<2> {
        let weight = layer.weight.val();
        match self.left.next() {
            Some(left) => weight.clone() / spectral::norm(&weight.transpose(), &left.val()),
            None => weight,
        }
    }

    fn conv(&mut self, conv: &SamePaddedConv, x: Tensor<4>) -> Tensor<4> {
        let Some(left) = self.left.next() else { return conv.forward(x) };
        let norm = spectral::norm(&flat(conv), &left.val());
        conv.forward_with(x, conv.weight.val() / norm.reshape([1, 1, 1, 1]))
    }
}

/// A convolution's weights as `[outputs, inputs * k * k]`.
fn flat(conv: &SamePaddedConv) -> Tensor<2> {
    let [outputs, inputs, height, width] = conv.weight.dims();
    conv.weight.val().reshape([outputs, inputs * height * width])
}

impl Discriminator {
    /// A discriminator with orthogonal weights.
    pub fn new(config: &InSituNetConfig, rng: &mut Rng, device: &Device) -> Self {
        let last = config.critic_channels.last().copied().unwrap_or(1);
        let inputs = std::iter::once(&COLOURS).chain(&config.critic_channels);
        let sizes = inputs.zip(&config.critic_channels);
        let mut new = Self {
            encoder: InputEncoder::new(&GROUPS, config.encoder, rng, device),
            condition: orthogonal_layer(rng, [GROUPS.len() * config.encoder, last], device),
            blocks: sizes.map(|(i, o)| DownBlock::new([*i, *o], rng, device)).collect(),
            last: DownBlock::new([last, last], rng, device),
            score: orthogonal_layer(rng, [last, 1], device),
            left: Vec::new(),
        };
        if config.spectral_norm {
            let left = |matrix: Tensor<2>| {
                let [outputs, _] = matrix.dims();
                let values: Vec<f32> = (0..outputs).map(|_| rng.normal()).collect();
                let length = values.iter().map(|v| v * v).sum::<f32>().sqrt().max(f32::MIN_POSITIVE);
                parameter(values.into_iter().map(|v| v / length).collect(), [outputs], device)
            };
            new.left = new.matrices().into_iter().map(left).collect();
        }
        new
    }

    /// The matrices `[outputs, inputs]` of all layers, in the order of [`Discriminator::forward`].
    fn matrices(&self) -> Vec<Tensor<2>> {
        let of = |layer: &Layer| layer.weight.val().transpose();
        let first = self.encoder.layers().chain([&self.condition]).map(of);
        let blocks = self.blocks.iter().chain([&self.last]).flat_map(DownBlock::all).map(flat);
        first.chain(blocks).chain([of(&self.score)]).collect()
    }

    /// Performs one step of power iteration on every layer.
    pub fn follow(&mut self) {
        let matrices = self.matrices();
        for (left, matrix) in self.left.iter_mut().zip(matrices) {
            *left = Param::from_tensor(spectral::next(&matrix, &left.val()).detach());
        }
    }

    /// Scores `[N, 1]` of images `[N, 3, side, side]` in [-1, 1] for inputs `[N, 4]`: `s(h) + <h, e>`, where h is the
    /// output of the convolutions for the image, summed over its pixels, and e an embedding of the inputs (Miyato and
    /// Koyama, "cGANs with projection discriminator", ICLR 2018).
    pub fn forward(&self, pictures: Tensor<4>, inputs: Tensor<2>) -> Tensor<2> {
        let mut normal = Normal { left: self.left.iter() };
        let encoded = self.encoder.forward_with(inputs, &mut |layer| normal.linear(layer));
        let encoded = relu(linear(encoded, normal.linear(&self.condition), Some(self.condition.bias.val())));
        let mut x = pictures;
        for (k, block) in self.blocks.iter().enumerate() {
            // no ReLU on the input image, whose negative values it would cut off
            let inner = if k == 0 { x.clone() } else { relu(x.clone()) };
            let inner = normal.conv(&block.convs[0], inner);
            let inner = normal.conv(&block.convs[1], relu(inner));
            let skip = if k == 0 { normal.conv(&block.skip, halved(x)) } else { halved(normal.conv(&block.skip, x)) };
            x = halved(inner) + skip;
        }
        let inner = normal.conv(&self.last.convs[0], relu(x.clone()));
        let inner = normal.conv(&self.last.convs[1], relu(inner));
        let x = relu(inner + normal.conv(&self.last.skip, x));
        let [n, channels, _, _] = x.dims();
        let seen: Tensor<2> = x.sum_dim(3).sum_dim(2).reshape([n, channels]);
        let score = linear(seen.clone(), normal.linear(&self.score), Some(self.score.bias.val()));
        score + (seen * encoded).sum_dim(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{Reference, device};
    use volseggs_base::rng::Purpose;
    use volseggs_core::model::params::to_vec;

    fn config() -> InSituNetConfig {
        let (channels, critic_channels) = (vec![4, 4, 4], vec![3, 5]);
        InSituNetConfig { channels, critic_channels, encoder: 6, ..InSituNetConfig::default() }
    }

    #[test]
    fn onnx_runtime_gives_the_same_scores() {
        let reference = Reference::read("discriminator");
        let config = InSituNetConfig { critic_channels: vec![4, 6], encoder: 5, spectral_norm: false, ..config() };
        let new = Discriminator::new(&config, &mut Rng::new(2, 0, Purpose::Custom(0)), &device());
        let discriminator = volseggs_core::model::params::load(new, &reference.0).unwrap();
        reference.check("scores", discriminator.forward(reference.input("pictures"), reference.input("inputs")));
    }

    #[test]
    fn every_layer_is_divided_by_its_largest_singular_value() {
        // orthogonal matrices have singular values of 1: the scores are the same with and without normalisation, and
        // weights ten times as large change them only without it
        let new = |spectral_norm: bool, factor: f32| {
            let config = InSituNetConfig { spectral_norm, ..config() };
            let mut new = Discriminator::new(&config, &mut Rng::new(2, 0, Purpose::Custom(0)), &device());
            for block in new.blocks.iter_mut().chain([&mut new.last]) {
                for conv in block.convs.iter_mut().chain([&mut block.skip]) {
                    conv.weight = Param::from_tensor(conv.weight.val().mul_scalar(factor));
                }
            }
            for _ in 0..10 {
                new.follow();
            }
            let mut rng = Rng::new(5, 0, Purpose::Custom(1));
            let pictures: Vec<f32> = (0..2 * 3 * 16 * 16).map(|_| rng.uniform() - 0.5).collect();
            let pictures = Tensor::from_data(burn::tensor::TensorData::new(pictures, [2, 3, 16, 16]), &device());
            let inputs = Tensor::<2>::from_floats([[0.1, 1.0, 0.0, 0.2], [0.9, 0.0, 1.0, -0.3]], &device());
            (new.left.len(), to_vec(new.forward(pictures, inputs)))
        };
        let (layers, plain) = new(false, 1.0);
        let (followed, normal) = new(true, 1.0);
        // two encoders of two layers, the condition, three blocks of three, the score
        assert_eq!((layers, followed), (0, 15));
        let off = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(off(&plain, &normal) < 1e-3 * plain[0].abs().max(1.0), "{plain:?} {normal:?}");
        assert!(off(&normal, &new(true, 10.0).1) < 1e-3 * plain[0].abs().max(1.0));
        assert!(off(&plain, &new(false, 10.0).1) > 1.0);
        assert!(plain.len() == 2 && plain[0] != plain[1]);
    }
}
