//! Encoders as a list of parameters and a function of tensors.

use crate::config::types::ModelConfig;
use crate::rng::Rng;
use burn::tensor::{Device, Tensor, TensorData};

/// A learnt tensor of an encoder with its initial values.
#[derive(Clone, Debug, PartialEq)]
pub struct EncoderParameter {
    /// Its name, unique within the encoder.
    pub name: String,
    /// Extents, slowest first.
    pub shape: Vec<usize>,
    /// Initial values, row-major.
    pub start: Vec<f32>,
}

impl EncoderParameter {
    /// Creates a parameter from its initial values, row-major.
    pub fn new(name: &str, shape: impl Into<Vec<usize>>, start: Vec<f32>) -> Self {
        Self { name: name.to_owned(), shape: shape.into(), start }
    }

    /// Creates a parameter whose initial values are drawn one after another, row-major.
    pub fn from_fn(name: &str, shape: impl Into<Vec<usize>>, mut value: impl FnMut() -> f32) -> Self {
        let shape = shape.into();
        let start = (0..shape.iter().product()).map(|_| value()).collect();
        Self { name: name.to_owned(), shape, start }
    }
}

/// The current learnt tensors of an encoder, by name.
#[derive(Clone, Debug)]
pub struct Parameters(Vec<(String, Vec<usize>, Tensor<1>)>);

impl Parameters {
    /// The parameters, given as name, shape and values.
    pub fn new(parts: impl Iterator<Item = (String, Vec<usize>, Tensor<1>)>) -> Self {
        Self(parts.collect())
    }

    /// Parameters at their initial values, on a device: for testing a definition on its own.
    pub fn start(parameters: Vec<EncoderParameter>, device: &Device) -> Self {
        let part = |p: EncoderParameter| {
            let len = p.start.len();
            (p.name, p.shape, Tensor::from_data(TensorData::new(p.start, [len]), device))
        };
        Self::new(parameters.into_iter().map(part))
    }

    /// Returns the tensor of that name, in its shape, with gradients in training.
    ///
    /// # Panics
    /// If the definition lists no parameter of that name with `D` extents.
    pub fn get<const D: usize>(&self, name: &str) -> Tensor<D> {
        let found = self.0.iter().find(|(n, shape, _)| n == name && shape.len() == D);
        let Some((_, shape, tensor)) = found else {
            let listed: Vec<String> = self.0.iter().map(|(n, shape, _)| format!("{n} {shape:?}")).collect();
            panic!("the encoder has no parameter \"{name}\" of {D} dimensions; it lists {}", listed.join(", "));
        };
        let mut extents = [0; D];
        extents.copy_from_slice(shape);
        tensor.clone().reshape(extents)
    }
}

/// An encoder: points and a time in, features for the decoder out.
///
/// Its parameters are optimised at the rate `optim.encoder`, saved in checkpoints and restored, each tensor as
/// `field.encoder.Extra.values.K` in the order of [`EncoderDefinition::parameters`]. Total variation (`loss.tv`,
/// `loss.tv_time`, `loss.one_prior`) applies to the factorised and the HexPlane encoder alone; a loss term can replace
/// it.
pub trait EncoderDefinition: Send + Sync {
    /// Number of features; at least 1.
    fn features(&self, config: &ModelConfig) -> usize;

    /// The parameters at their initial values. `rng` depends on the run's seed alone. Called again when a scene is
    /// loaded, so names, shapes and order must follow from `config`.
    fn parameters(&self, config: &ModelConfig, rng: &mut Rng) -> Vec<EncoderParameter>;

    /// Features `[N, features]` of points `[N, 3]`, in [-1, 1] within the box of the field (a Gaussian may drift out of
    /// it), at `time` in [0, 1]. Points are always finite: `speed.cull_visits`, which marks skipped Gaussians with NaN,
    /// is rejected with such an encoder.
    ///
    /// Must be differentiable by burn's autodiff, in the points too: these gradients move the means.
    fn forward(&self, parameters: &Parameters, points: Tensor<2>, time: f32) -> Tensor<2>;
}
