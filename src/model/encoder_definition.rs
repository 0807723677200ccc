//! Space-time encoders.

use crate::config::types::ModelConfig;
use crate::registry::{NotRegistered, Registry};
use crate::rng::Rng;
use burn::tensor::{Device, Tensor, TensorData};
use std::sync::Arc;

pub(crate) static ENCODERS: Registry<dyn EncoderDefinition> = Registry::new("encoder");

/// A learnt tensor of an encoder, as it starts.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Its name, unlike those of the encoder's others.
    pub name: String,
    /// Extents, slowest first.
    pub shape: Vec<usize>,
    /// First values, row-major.
    pub start: Vec<f32>,
}

impl Parameter {
    /// A parameter from its first values, row-major.
    #[must_use]
    pub fn new(name: &str, shape: impl Into<Vec<usize>>, start: Vec<f32>) -> Self {
        Self { name: name.to_owned(), shape: shape.into(), start }
    }

    /// A parameter whose first values are drawn one after another, row-major.
    #[must_use]
    pub fn from_fn(name: &str, shape: impl Into<Vec<usize>>, mut value: impl FnMut() -> f32) -> Self {
        let shape = shape.into();
        let start = (0..shape.iter().product()).map(|_| value()).collect();
        Self { name: name.to_owned(), shape, start }
    }
}

/// The learnt tensors of an encoder as they stand, by name.
#[derive(Clone, Debug)]
pub struct Parameters(Vec<(String, Vec<usize>, Tensor<1>)>);

impl Parameters {
    pub(crate) fn new(parts: impl Iterator<Item = (String, Vec<usize>, Tensor<1>)>) -> Self {
        Self(parts.collect())
    }

    /// Parameters at their first values, on a device: for tests of a definition alone.
    #[must_use]
    pub fn start(parameters: Vec<Parameter>, device: &Device) -> Self {
        let part = |p: Parameter| {
            let len = p.start.len();
            (p.name, p.shape, Tensor::from_data(TensorData::new(p.start, [len]), device))
        };
        Self::new(parameters.into_iter().map(part))
    }

    /// The tensor of that name, in its shape, with gradients in training.
    ///
    /// # Panics
    /// If the definition lists no parameter of that name with `D` extents.
    #[must_use]
    pub fn get<const D: usize>(&self, name: &str) -> Tensor<D> {
        let found = self.0.iter().find(|(n, shape, _)| n == name && shape.len() == D);
        let Some((_, shape, tensor)) = found else {
            let listed: Vec<String> = self.0.iter().map(|(n, shape, _)| format!("{n} {shape:?}")).collect();
            panic!("the encoder has no parameter \"{name}\" of {D} extents; it lists {}", listed.join(", "));
        };
        let mut extents = [0; D];
        extents.copy_from_slice(shape);
        tensor.clone().reshape(extents)
    }
}

/// An encoder: points and a time in, features for the decoder out.
///
/// What it learns is optimised with the rate `optim.encoder`, saved in checkpoints and read back, each tensor as
/// `field.encoder.Extra.values.K` in the order of [`EncoderDefinition::parameters`]. Total variation
/// (`loss.tv`, `loss.tv_time`, `loss.one_prior`) is of the factorised and the HexPlane encoder alone; a loss term can take its place.
pub trait EncoderDefinition: Send + Sync {
    /// Number of features; at least 1.
    fn features(&self, config: &ModelConfig) -> usize;

    /// What is learnt, at its first values. `rng` depends on the run's seed alone. Asked for again when a scene is loaded,
    /// so names, shapes and order must follow from `config`.
    fn parameters(&self, config: &ModelConfig, rng: &mut Rng) -> Vec<Parameter>;

    /// Features `[N, features]` of points `[N, 3]`, in [-1, 1] within the box of the field (a Gaussian may wander out of
    /// it), at `time` in [0, 1]. Points are always finite: `speed.cull_visits`, which marks Gaussians that are left out by
    /// NaN, is refused with such an encoder.
    ///
    /// Must be differentiable by burn's tape, in the points too: the means move by these gradients.
    fn forward(&self, parameters: &Parameters, points: Tensor<2>, time: f32) -> Tensor<2>;
}

/// The encoder of that name.
///
/// # Errors
/// [`NotRegistered`], which lists those that are.
pub fn find_encoder(name: &str) -> Result<Arc<dyn EncoderDefinition>, NotRegistered> {
    ENCODERS.get(name)
}
