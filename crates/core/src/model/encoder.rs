//! Space-time encoders: a point and a time in, features out. To add a built-in one, write its file here, a line in
//! [`ENCODERS`] and, if it is a burn module of its own, a variant of [`Encoder`].

pub mod factorised;
pub mod hexplane;
pub mod implicit;

use super::d3dgs::DeformationNetwork;
use super::defined_encoder::DefinedEncoder;
use crate::config::types::ModelConfig;
use crate::memory::product;
use crate::registry::{NotRegistered, Registry};
use burn::module::Module;
use burn::tensor::{Device, Tensor};
use factorised::{Factorised, FactorisedEncoder};
use hexplane::{HexPlane, HexPlaneEncoder};
use implicit::{Implicit, ImplicitEncoder};

/// All encoders, which `model.encoder` chooses from.
pub static ENCODERS: Registry<dyn EncoderFactory> =
    Registry::new("encoder", &[("factorised", &Factorised), ("hexplane", &HexPlane), ("implicit", &Implicit)]);

/// Makes encoders of one kind, and says from a configuration alone how large they are. None of the numbers overflows,
/// whatever the configuration says.
pub trait EncoderFactory: Send + Sync {
    /// Rejects settings that no encoder can have.
    ///
    /// # Errors
    /// The first such key with its value, and the values allowed.
    fn check(&self, _: &ModelConfig) -> Result<(), String> {
        Ok(())
    }

    /// Creates a new encoder from a checked configuration.
    fn create(&self, config: &ModelConfig, seed: u64, device: &Device) -> Encoder;

    /// Number of features per Gaussian.
    fn features(&self, config: &ModelConfig) -> u128 {
        product(&[config.levels, config.channels])
    }

    /// Number of parameters; 0 if it is not known.
    fn parameters(&self, config: &ModelConfig) -> u128;

    /// Number of values that a step keeps per Gaussian until the gradients are computed, besides the features.
    fn kept_values(&self, _: &ModelConfig) -> u128 {
        0
    }

    /// Number of values per Gaussian in its widest tensor, if that is not the features.
    fn widest_layer(&self, _: &ModelConfig) -> u128 {
        0
    }

    /// Whether it skips points that are NaN, as `speed.cull_visits` needs.
    fn skips_culled(&self) -> bool {
        false
    }

    /// Time that it takes together with the decoder, relative to the factorised encoder; for the estimate of a sweep.
    fn relative_time(&self) -> f64 {
        1.0
    }

    /// Multiply-adds per Gaussian beyond that time; for the estimate of a sweep.
    fn products(&self, _: &ModelConfig) -> f64 {
        0.0
    }
}

/// Returns what makes encoders of that name.
///
/// # Errors
/// [`NotRegistered`], which lists the registered names.
pub fn find_encoder(name: &str) -> Result<&'static dyn EncoderFactory, NotRegistered> {
    ENCODERS.get(name)
}

/// One of the encoders.
#[derive(Module, Debug)]
#[allow(clippy::large_enum_variant)] // one of them exists per scene
pub enum Encoder {
    /// Planes, lines and temporal vectors.
    Factorised(FactorisedEncoder),
    /// Planes of space and planes of space and time.
    HexPlane(HexPlaneEncoder),
    /// A multi-layer perceptron.
    Implicit(ImplicitEncoder),
    /// One made of a list of parameters and a function, such as those of other programs.
    Extra(DefinedEncoder),
    /// The whole network of D3DGS: it outputs the changes directly, and there is no decoder.
    D3dgs(DeformationNetwork),
}

impl Encoder {
    /// Features `[N, features]` of points `[N, 3]` in [-1, 1] at `time` in [0, 1]; `None` for the network of D3DGS, which
    /// has none.
    pub fn forward(&self, points: Tensor<2>, time: f32) -> Option<Tensor<2>> {
        match self {
            Self::Factorised(e) => Some(e.forward(points, time)),
            Self::HexPlane(e) => Some(e.forward(points, time)),
            Self::Implicit(e) => Some(e.forward(points, time)),
            Self::Extra(e) => Some(e.forward(points, time)),
            Self::D3dgs(_) => None,
        }
    }
}
