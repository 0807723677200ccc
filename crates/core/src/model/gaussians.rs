//! Canonical Gaussians: the five learnable attributes (the paper's section on 3DGS), and their shading.

use super::appearance::Headlight;
use super::embedding::HostEmbedding;
use super::host::HostGaussians;
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};
use volseggs_kernels::sh::Bands;
use volseggs_kernels::splat::SplatInputs;

/// N canonical Gaussians.
#[derive(Module, Debug)]
pub struct Gaussians {
    /// World positions `[N, 3]`.
    pub means: Param<Tensor<2>>,
    /// Quaternions w, x, y, z `[N, 4]`, not necessarily of unit length.
    pub rotations: Param<Tensor<2>>,
    /// Natural logarithm of the standard deviations `[N, 3]`, scene units.
    pub log_scales: Param<Tensor<2>>,
    /// Opacity before the sigmoid `[N]`.
    pub opacity_logits: Param<Tensor<1>>,
    /// Spherical-harmonics coefficients `[N, K, 3]`.
    pub sh: Param<Tensor<3>>,
    /// Shading, with `model.appearance = "headlight"`.
    pub headlight: Option<Headlight>,
    /// Embeddings `[N, E]` for the decoder, with `model.embedding` above 0, see [`super::embedding`].
    pub embedding: Option<Param<Tensor<2>>>,
}

impl Gaussians {
    /// Moves host attributes to a device.
    ///
    /// # Panics
    /// If the arrays disagree on N.
    pub fn from_host(mut host: HostGaussians, device: &Device) -> Self {
        let headlight = host.shading.take().map(|shading| Headlight::from_host(shading, device));
        let embedding = host.embedding.take().map(|embedding| embedding.into_param(device));
        let SplatInputs { means, rotations, log_scales, opacity_logits, sh, .. } = host.into_splat(device);
        Self {
            means: Param::from_tensor(means),
            rotations: Param::from_tensor(rotations),
            log_scales: Param::from_tensor(log_scales),
            opacity_logits: Param::from_tensor(opacity_logits),
            sh: Param::from_tensor(sh),
            headlight,
            embedding,
        }
    }

    /// The canonical Gaussians as they are drawn without a deformation; with gradients where the parameters have them.
    pub fn val(&self) -> SplatInputs {
        let (means, rotations, log_scales) = (self.means.val(), self.rotations.val(), self.log_scales.val());
        let plain = SplatInputs::new(means, rotations, log_scales, self.opacity_logits.val(), self.sh.val());
        SplatInputs { shading: self.headlight.as_ref().map(Headlight::val), ..plain }
    }

    /// Copies the attributes to the host.
    pub fn to_host(&self) -> HostGaussians {
        let embedding = self.embedding.as_ref().map(HostEmbedding::from_param);
        HostGaussians { embedding, ..HostGaussians::from_splat(self.val()) }
    }

    /// Number of Gaussians.
    pub fn count(&self) -> usize {
        self.means.dims()[0]
    }

    /// Highest spherical-harmonics degree of the coefficients.
    pub fn sh_degree(&self) -> usize {
        Bands::from_count(self.sh.dims()[1]).map_or(0, |(_, degree)| degree)
    }
}
