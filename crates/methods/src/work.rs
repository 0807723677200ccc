//! What a method costs, for the estimate of a sweep.

use volseggs_core::config::types::ModelConfig;
use volseggs_core::model::encoder::find_encoder;
use volseggs_core::model::size;

/// The cost of a method, for a rough estimate of its duration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MethodWork {
    /// That of a network without Gaussians.
    Network {
        /// Multiply-adds of a step's forward pass.
        step: f64,
        /// Multiply-adds per pixel of a rendered image.
        pixel: f64,
        /// Bytes of the parameters with their moments, and of the values that a step keeps.
        bytes: f64,
    },
    /// That of Gaussians, as many as the shared sections say, over the steps of both stages.
    Gaussians(GaussianWork),
}

/// The cost of what gives the Gaussians their attributes at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaussianWork {
    /// Time in the joint stage, relative to that of the factorised encoder with its decoder.
    pub field: f64,
    /// Multiply-adds for each Gaussian of a network, in addition.
    pub products: f64,
    /// Values that a step keeps for each Gaussian, beyond those of the factorised encoder.
    pub kept: f64,
    /// Whether a step of warm-up takes as long as one of the joint stage.
    pub in_warmup: bool,
}

impl GaussianWork {
    /// The cost of the field that `[model]` describes.
    pub fn of_the_field(model: &ModelConfig) -> Self {
        let (field, products) =
            find_encoder(&model.encoder).map_or((1.0, 0.0), |e| (e.relative_time(), e.products(model)));
        Self { field, products, kept: size::encoder_values(model) as f64, in_warmup: false }
    }
}
