//! Image layers: convolutions, batch normalisation, doubling and halving of the side length.

use crate::layers::parameter;
use burn::module::{Module, Param};
use burn::tensor::module::conv2d;
use burn::tensor::ops::ConvOptions;
use burn::tensor::{Device, Tensor};
use rayon::prelude::*;
use volseggs_base::rng::Rng;
use volseggs_core::model::encoder::implicit::Layer;

/// A convolution that keeps width and height.
#[derive(Module, Debug)]
pub struct SamePaddedConv {
    /// `[outputs, inputs, k, k]`, k odd.
    pub weight: Param<Tensor<4>>,
    /// `[outputs]`
    pub bias: Option<Param<Tensor<1>>>,
}

impl SamePaddedConv {
    /// A convolution with windows of `side` pixels; its weights are an orthogonal matrix, its biases 0.
    pub fn new(rng: &mut Rng, [inputs, outputs]: [usize; 2], side: usize, has_bias: bool, device: &Device) -> Self {
        let weight = orthogonal(rng, outputs, inputs * side * side);
        Self {
            weight: parameter(weight, [outputs, inputs, side, side], device),
            bias: has_bias.then(|| parameter(vec![0.0; outputs], [outputs], device)),
        }
    }

    /// Maps `[N, inputs, H, W]` to `[N, outputs, H, W]`.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        self.forward_with(x, self.weight.val())
    }

    /// As [`SamePaddedConv::forward`], with other weights of the same shape.
    pub fn forward_with(&self, x: Tensor<4>, weight: Tensor<4>) -> Tensor<4> {
        let padding = self.weight.dims()[2] / 2;
        conv2d(x, weight, self.bias.as_ref().map(Param::val), ConvOptions::new([1; 2], [padding; 2], [1; 2], 1))
    }
}

/// A linear layer; its weights are an orthogonal matrix, its biases 0.
pub fn orthogonal_layer(rng: &mut Rng, [inputs, outputs]: [usize; 2], device: &Device) -> Layer {
    Layer {
        weight: parameter(orthogonal(rng, inputs, outputs), [inputs, outputs], device),
        bias: parameter(vec![0.0; outputs], [outputs], device),
    }
}

/// A random matrix `[rows, columns]`, row-major, whose rows (or columns, if they are fewer) are orthonormal: normal
/// deviates orthogonalised one after the other, twice, to remove rounding errors.
pub fn orthogonal(rng: &mut Rng, rows: usize, columns: usize) -> Vec<f32> {
    let (few, many) = (rows.min(columns), rows.max(columns));
    let mut vectors: Vec<Vec<f64>> = (0..few).map(|_| (0..many).map(|_| f64::from(rng.normal())).collect()).collect();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    for _ in 0..2 {
        for k in 0..few {
            let (done, rest) = vectors.split_at_mut(k + 1);
            let pivot = &mut done[k];
            let norm = dot(pivot, pivot).sqrt();
            pivot.iter_mut().for_each(|v| *v /= norm);
            let pivot: &[f64] = pivot;
            rest.par_iter_mut().for_each(|vector| {
                let along = dot(vector, pivot);
                vector.iter_mut().zip(pivot).for_each(|(v, p)| *v -= along * p);
            });
        }
    }
    let at = |row: usize, column: usize| {
        if rows <= columns { vectors[row][column] } else { vectors[column][row] }
    };
    (0..rows * columns).map(|i| at(i / columns, i % columns) as f32).collect()
}

/// Added to variances.
const EPSILON: f64 = 1e-5;
/// Fraction of the statistics that each batch replaces.
const MOMENTUM: f64 = 0.1;

/// Normalisation of each channel: by the batch's mean and variance in training, by running statistics in drawing.
#[derive(Module, Debug)]
pub struct BatchNorm {
    scale: Param<Tensor<1>>,
    shift: Param<Tensor<1>>,
    /// Running mean; changed only by [`BatchNorm::renew`].
    running_mean: Param<Tensor<1>>,
    /// Running variance.
    running_variance: Param<Tensor<1>>,
}

/// Mean and variance `[C]` of a batch, without gradients.
pub type BatchMoments = [Tensor<1>; 2];

/// Suffixes of the names of parameters that are statistics and not trained.
pub const STATISTICS: [&str; 2] = ["running_mean", "running_variance"];

impl BatchNorm {
    /// Creates a normalisation of `channels` channels.
    pub fn new(channels: usize, device: &Device) -> Self {
        let all = |value: f32| parameter(vec![value; channels], [channels], device);
        Self { scale: all(1.0), shift: all(0.0), running_mean: all(0.0), running_variance: all(1.0) }
    }

    /// Normalises `[N, C, H, W]` by its own moments, which are appended to `seen`, or by the running statistics if
    /// `seen` is `None`.
    pub fn forward(&self, x: Tensor<4>, seen: Option<&mut Vec<BatchMoments>>) -> Tensor<4> {
        let [n, channels, height, width] = x.dims();
        let wide = |t: Tensor<1>| t.reshape([1, channels, 1, 1]);
        let (mean, variance) = match seen {
            None => (wide(self.running_mean.val()), wide(self.running_variance.val())),
            Some(seen) => {
                let over = |t: Tensor<4>| t.mean_dim(3).mean_dim(2).mean_dim(0);
                let mean = over(x.clone());
                let variance = over((x.clone() - mean.clone()).square());
                let count = (n * height * width) as f64;
                // as in PyTorch: divided by the count to normalise, by one less for the running variance
                let kept = variance.clone().mul_scalar(count / (count - 1.0).max(1.0));
                seen.push([mean.clone(), kept].map(|t| t.reshape([channels]).detach()));
                (mean, variance)
            }
        };
        let normal = (x - mean) / variance.add_scalar(EPSILON).sqrt();
        normal * wide(self.scale.val()) + wide(self.shift.val())
    }

    /// Updates the running statistics with the moments of a batch.
    pub fn renew(&mut self, moments: BatchMoments) {
        let [mean, variance] = moments;
        for (kept, new) in [(&mut self.running_mean, mean), (&mut self.running_variance, variance)] {
            let old = kept.val().detach();
            let mean = old.mul_scalar(1.0 - MOMENTUM) + new.mul_scalar(MOMENTUM);
            *kept = Param::from_tensor(mean.detach());
        }
    }
}

/// Doubles width and height, repeating each pixel four times.
pub fn doubled(x: Tensor<4>) -> Tensor<4> {
    let [n, c, h, w] = x.dims();
    let x = x.reshape([n, c, h, 1, w, 1]).expand([n, c, h, 2, w, 2]);
    x.reshape([n, c, 2 * h, 2 * w])
}

/// Halves width and height, averaging four pixels.
pub fn halved(x: Tensor<4>) -> Tensor<4> {
    let [n, c, h, w] = x.dims();
    x.reshape([n, c, h / 2, 2, w / 2, 2]).mean_dim(5).mean_dim(3).reshape([n, c, h / 2, w / 2])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::device;
    use burn::tensor::TensorData;
    use volseggs_base::rng::Purpose;
    use volseggs_core::model::params::to_vec;

    fn image(values: Vec<f32>, shape: [usize; 4]) -> Tensor<4> {
        Tensor::from_data(TensorData::new(values, shape), &device())
    }

    #[test]
    fn orthogonal_matrices_are() {
        for (rows, columns) in [(5, 5), (3, 20), (20, 3), (1, 4)] {
            let m = orthogonal(&mut Rng::new(1, 2, Purpose::Custom(3)), rows, columns);
            let at = |i: usize, j: usize| if rows <= columns { m[i * columns + j] } else { m[j * columns + i] };
            for a in 0..rows.min(columns) {
                for b in 0..rows.min(columns) {
                    let product: f32 = (0..rows.max(columns)).map(|k| at(a, k) * at(b, k)).sum();
                    let expected = if a == b { 1.0 } else { 0.0 };
                    assert!((product - expected).abs() < 1e-5, "{rows}x{columns} {a} {b}: {product}");
                }
            }
        }
    }

    #[test]
    fn sides_are_doubled_and_halved() {
        let x = image((0..12).map(|v| v as f32).collect(), [1, 2, 2, 3]);
        let twice = to_vec(doubled(x.clone()));
        assert_eq!(twice[..12], [0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 0.0, 0.0, 1.0, 1.0, 2.0, 2.0]);
        assert_eq!(to_vec(halved(doubled(x.clone()))), to_vec(x));
        let x = image((0..16).map(|v| v as f32).collect(), [1, 1, 4, 4]);
        assert_eq!(to_vec(halved(x)), [2.5, 4.5, 10.5, 12.5]);
    }

    #[test]
    fn a_batch_is_normalised_and_remembered_as_in_pytorch() {
        // torch.nn.BatchNorm2d(2) on torch.arange(16.).reshape(2, 2, 2, 2): values from the formula in its
        // documentation
        let x = image((0..16).map(|v| v as f32).collect(), [2, 2, 2, 2]);
        let mut norm = BatchNorm::new(2, &device());
        let mut seen = Vec::new();
        let y = to_vec(norm.forward(x.clone(), Some(&mut seen)));
        // channel 0 holds 0..4 and 8..12: mean 5.5, variance 17.25
        let expected = |v: f64| (v - 5.5) / (17.25f64 + 1e-5).sqrt();
        for (k, v) in [0.0, 1.0, 2.0, 3.0].into_iter().enumerate() {
            assert!((f64::from(y[k]) - expected(v)).abs() < 1e-5);
            assert!((f64::from(y[8 + k]) - expected(v + 8.0)).abs() < 1e-5);
        }
        let [mean, variance] = seen.remove(0).map(to_vec);
        assert_eq!(mean, [5.5, 9.5]);
        assert!(variance.iter().all(|v| (v - 17.25 * 8.0 / 7.0).abs() < 1e-4), "{variance:?}");
        norm.renew([mean, variance].map(|v| Tensor::from_data(TensorData::new(v, [2]), &device())));
        assert!(to_vec(norm.running_mean.val()).iter().zip([0.55, 0.95]).all(|(a, b)| (a - b).abs() < 1e-6));
        let kept = 0.9 + 0.1 * 17.25 * 8.0 / 7.0;
        assert!(to_vec(norm.running_variance.val()).iter().all(|v| (v - kept).abs() < 1e-5));
        let drawn = to_vec(norm.forward(x, None));
        assert!((f64::from(drawn[0]) + 0.55 / (f64::from(kept) + 1e-5).sqrt()).abs() < 1e-5);
    }
}
