//! Per-Gaussian numbers that the decoder sees beside the features of position and time.
//!
//! The field alone gives Gaussians at one position the same motion, and each of its channels is of rank 1 in space.
//! With an embedding (like the per-Gaussian embedding of E-D3DGS, Bae et al., ECCV 2024, where it replaces the field)
//! neighbours may move apart, appear and vanish at different times. It starts at zero, so that training begins as
//! without it; it is copied when a Gaussian is cloned or split; and only canonical Gaussians have it, not those at a
//! time.

use super::params::to_vec;
use burn::module::Param;
use burn::tensor::{Device, Tensor, TensorData};

/// Name of the embedding among a Gaussian's attributes, see [`super::HostGaussians::columns`].
pub const EMBEDDING: &str = "embedding";

/// The embeddings of N Gaussians on the host.
#[derive(Clone, Debug, PartialEq)]
pub struct HostEmbedding {
    /// E, the numbers per Gaussian, at least 1.
    pub width: usize,
    /// `[N, E]`
    pub values: Vec<f32>,
}

impl HostEmbedding {
    /// The initial embedding: zeros for `n` Gaussians, or `None` where `width` (`model.embedding`) is 0.
    pub fn first(width: usize, n: usize) -> Option<Self> {
        (width > 0).then(|| Self { width, values: vec![0.0; n * width] })
    }

    /// Moves it to a device, `[N, E]`.
    pub(super) fn into_param(self, device: &Device) -> Param<Tensor<2>> {
        let n = self.values.len() / self.width;
        Param::from_tensor(Tensor::from_data(TensorData::new(self.values, [n, self.width]), device))
    }

    /// Copied from a device, `[N, E]`.
    pub(super) fn from_param(param: &Param<Tensor<2>>) -> Self {
        Self { width: param.dims()[1], values: to_vec(param.val()) }
    }
}
