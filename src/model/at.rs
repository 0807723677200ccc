//! The Gaussians of one time on the host: what segmentation, tracking, edits and files work on.

use super::Scene;
use super::params::to_vec;
use burn::tensor::{Device, Tensor, TensorData};
use volseggs_kernels::splat::SplatInputs;

/// N Gaussians at one time, after deformation; flat and row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GaussiansAt {
    /// Positions `[N, 3]`, world units.
    pub means: Vec<f32>,
    /// Quaternions w, x, y, z `[N, 4]`, not necessarily of unit length.
    pub rotations: Vec<f32>,
    /// Natural logarithm of the standard deviations `[N, 3]`, world units.
    pub log_scales: Vec<f32>,
    /// Opacity before the sigmoid `[N]`.
    pub opacity_logits: Vec<f32>,
    /// Spherical-harmonics coefficients `[N, K, 3]`.
    pub sh: Vec<f32>,
    /// K: 1, 4, 9 or 16.
    pub sh_stride: usize,
}

impl GaussiansAt {
    /// N.
    #[must_use]
    pub fn len(&self) -> usize {
        self.opacity_logits.len()
    }

    /// True without any Gaussian.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.opacity_logits.is_empty()
    }

    /// Linear opacity `[N]`.
    #[must_use]
    pub fn opacity(&self) -> Vec<f32> {
        self.opacity_logits.iter().map(|o| 1.0 / (1.0 + (-o).exp())).collect()
    }

    /// Means `[M, 3]` of what can be seen: opacity above 1 / 255.
    #[must_use]
    pub fn visible_means(&self) -> Vec<f32> {
        let rows = self.means.chunks_exact(3).zip(self.opacity()).filter(|(_, o)| *o > 1.0 / 255.0);
        rows.flat_map(|(m, _)| m).copied().collect()
    }

    /// Rows of `members` alone, in their order.
    ///
    /// # Panics
    /// If a member is not below N.
    #[must_use]
    pub fn subset(&self, members: &[u32]) -> Self {
        let rows = |values: &[f32], width: usize| {
            members.iter().flat_map(|&i| &values[i as usize * width..][..width]).copied().collect()
        };
        Self {
            means: rows(&self.means, 3),
            rotations: rows(&self.rotations, 4),
            log_scales: rows(&self.log_scales, 3),
            opacity_logits: rows(&self.opacity_logits, 1),
            sh: rows(&self.sh, 3 * self.sh_stride),
            sh_stride: self.sh_stride,
        }
    }

    /// All of it on a device, as splatting takes it.
    ///
    /// # Panics
    /// If the arrays disagree about N.
    #[must_use]
    pub fn to_splat(&self, device: &Device) -> SplatInputs {
        let n = self.len();
        let rows = |v: &[f32], width: usize| Tensor::<2>::from_data(TensorData::new(v.to_vec(), [n, width]), device);
        SplatInputs {
            means: rows(&self.means, 3),
            rotations: rows(&self.rotations, 4),
            log_scales: rows(&self.log_scales, 3),
            opacity_logits: Tensor::from_data(TensorData::new(self.opacity_logits.clone(), [n]), device),
            sh: Tensor::from_data(TensorData::new(self.sh.clone(), [n, self.sh_stride, 3]), device),
            screen_offsets: None,
        }
    }
}

impl Scene {
    /// The largest opacity of each Gaussian over evenly spaced times, `[N]`.
    #[must_use]
    pub fn largest_opacity(&self) -> Vec<f32> {
        const TIMES: usize = 11;
        let mut largest = vec![f32::NEG_INFINITY; self.gaussians.count()];
        for k in 0..TIMES {
            let logits = to_vec(self.at(k as f32 / (TIMES - 1) as f32).opacity_logits);
            largest.iter_mut().zip(logits).for_each(|(a, b)| *a = a.max(b));
        }
        largest.into_iter().map(|logit| 1.0 / (1.0 + (-logit).exp())).collect()
    }

    /// The Gaussians at `time` in [0, 1], on the host.
    #[must_use]
    pub fn host_at(&self, time: f32) -> GaussiansAt {
        let at = self.at(time);
        GaussiansAt {
            means: to_vec(at.means),
            rotations: to_vec(at.rotations),
            log_scales: to_vec(at.log_scales),
            opacity_logits: to_vec(at.opacity_logits),
            sh_stride: self.gaussians.sh.dims()[1],
            sh: to_vec(self.gaussians.sh.val()),
        }
    }
}
