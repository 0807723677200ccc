//! Canonical Gaussians: the five learnable attributes (the paper's section on 3DGS).

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};

/// N canonical Gaussians.
#[derive(Module, Debug)]
pub struct Gaussians {
    /// World positions `[N, 3]`.
    pub means: Param<Tensor<2>>,
    /// Quaternions w, x, y, z `[N, 4]`, not necessarily of unit length.
    pub rotations: Param<Tensor<2>>,
    /// Natural logarithm of the standard deviations `[N, 3]`, world units.
    pub log_scales: Param<Tensor<2>>,
    /// Opacity before the sigmoid `[N]`.
    pub opacity_logits: Param<Tensor<1>>,
    /// Spherical-harmonics coefficients `[N, K, 3]`.
    pub sh: Param<Tensor<3>>,
}

/// The same attributes on the host, row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HostGaussians {
    /// `[N, 3]`
    pub means: Vec<f32>,
    /// `[N, 4]`
    pub rotations: Vec<f32>,
    /// `[N, 3]`
    pub log_scales: Vec<f32>,
    /// `[N]`
    pub opacity_logits: Vec<f32>,
    /// `[N, K, 3]`
    pub sh: Vec<f32>,
}

impl Gaussians {
    /// Puts host attributes on a device.
    ///
    /// # Panics
    /// If the arrays disagree about N.
    pub fn from_host(host: HostGaussians, device: &Device) -> Self {
        let n = host.opacity_logits.len();
        let k = if n == 0 { 1 } else { host.sh.len() / (3 * n) };
        let param2 =
            |v: Vec<f32>, d: usize| Param::from_tensor(Tensor::<2>::from_data(TensorData::new(v, [n, d]), device));
        Self {
            means: param2(host.means, 3),
            rotations: param2(host.rotations, 4),
            log_scales: param2(host.log_scales, 3),
            opacity_logits: Param::from_tensor(Tensor::from_data(TensorData::new(host.opacity_logits, [n]), device)),
            sh: Param::from_tensor(Tensor::from_data(TensorData::new(host.sh, [n, k, 3]), device)),
        }
    }

    /// Copies the attributes to the host.
    pub fn to_host(&self) -> HostGaussians {
        use super::params::to_vec;
        HostGaussians {
            means: to_vec(self.means.val()),
            rotations: to_vec(self.rotations.val()),
            log_scales: to_vec(self.log_scales.val()),
            opacity_logits: to_vec(self.opacity_logits.val()),
            sh: to_vec(self.sh.val()),
        }
    }

    /// Number of Gaussians.
    pub fn count(&self) -> usize {
        self.means.dims()[0]
    }

    /// Spherical-harmonics degree that the coefficients allow.
    pub fn sh_degree(&self) -> usize {
        self.sh.dims()[1].isqrt() - 1
    }
}
