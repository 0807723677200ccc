//! Numbers of each Gaussian's own that the decoder sees beside the features of its place and time.
//!
//! The field alone gives Gaussians at one place one motion, and a channel of it is of rank 1 in space. With an embedding
//! (as the per-Gaussian embedding of E-D3DGS, Bae et al., ECCV 2024, there in the place of the field) neighbours may move
//! apart, appear and vanish at times of their own. It starts at zero, so that training begins as without it, is copied when a
//! Gaussian is cloned or split, and belongs to canonical Gaussians alone: those at a time have none.

use super::params::to_vec;
use burn::module::Param;
use burn::tensor::{Device, Tensor, TensorData};

/// Its name among a Gaussian's attributes, see [`super::HostGaussians::columns`].
pub const EMBEDDING: &str = "embedding";

/// The embeddings of N Gaussians on the host.
#[derive(Clone, Debug, PartialEq)]
pub struct HostEmbedding {
    /// E, numbers a Gaussian, at least 1.
    pub width: usize,
    /// `[N, E]`
    pub values: Vec<f32>,
}

impl HostEmbedding {
    /// What training starts with: zeros for `n` Gaussians, or nothing where `model.embedding` is 0.
    #[must_use]
    pub fn first(width: usize, n: usize) -> Option<Self> {
        (width > 0).then(|| Self { width, values: vec![0.0; n * width] })
    }

    /// `[N, E]` on a device.
    pub(super) fn into_param(self, device: &Device) -> Param<Tensor<2>> {
        let n = self.values.len() / self.width;
        Param::from_tensor(Tensor::from_data(TensorData::new(self.values, [n, self.width]), device))
    }

    /// Copied from a device, `[N, E]`.
    pub(super) fn from_param(param: &Param<Tensor<2>>) -> Self {
        Self { width: param.dims()[1], values: to_vec(param.val()) }
    }
}
