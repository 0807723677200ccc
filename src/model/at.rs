//! The Gaussians of one time on the host: what segmentation, tracking, edits and files work on.

use super::Scene;
use super::gaussians::{Gaussians, HostGaussians};
use super::params::to_vec;
use burn::tensor::{Device, Tensor, TensorData};
use volseggs_kernels::activation::sigmoid;
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
        (0..self.len()).map(|i| self.opacity_of(i)).collect()
    }

    /// Linear opacity of one Gaussian.
    ///
    /// # Panics
    /// If `i` is not below N.
    #[must_use]
    pub fn opacity_of(&self, i: usize) -> f32 {
        sigmoid(self.opacity_logits[i])
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
    /// The largest opacity over evenly spaced times of each Gaussian that is `asked` `[N]`, `[N]`; 0 for the others,
    /// which cost nothing.
    ///
    /// # Panics
    /// If `asked` is not of length N.
    #[must_use]
    pub fn largest_opacity(&self, asked: &[bool]) -> Vec<f32> {
        const TIMES: usize = 11;
        assert_eq!(asked.len(), self.gaussians.count(), "asked: [N]");
        let which: Vec<usize> = (0..asked.len()).filter(|&i| asked[i]).collect();
        let mut out = vec![0.0; asked.len()];
        if which.is_empty() {
            return out;
        }
        let changes = self.spec.deformed && self.spec.model.deform_opacity;
        let rows = self.rows_without_colour(&which);
        let mut largest = vec![f32::NEG_INFINITY; which.len()];
        for k in 0..if changes { TIMES } else { 1 } {
            let at = if changes {
                self.field.deform(&rows, k as f32 / (TIMES - 1) as f32, None).opacity_logits
            } else {
                rows.opacity_logits.val()
            };
            largest.iter_mut().zip(to_vec(at)).for_each(|(a, b)| *a = a.max(b));
        }
        which.iter().zip(largest).for_each(|(&i, logit)| out[i] = sigmoid(logit));
        out
    }

    /// Some canonical Gaussians, all grey: the deformation does not look at colours.
    fn rows_without_colour(&self, which: &[usize]) -> Gaussians {
        let rows = |values: Vec<f32>, width: usize| {
            which.iter().flat_map(|&i| &values[i * width..][..width]).copied().collect::<Vec<f32>>()
        };
        let g = &self.gaussians;
        let host = HostGaussians {
            means: rows(to_vec(g.means.val()), 3),
            rotations: rows(to_vec(g.rotations.val()), 4),
            log_scales: rows(to_vec(g.log_scales.val()), 3),
            opacity_logits: rows(to_vec(g.opacity_logits.val()), 1),
            sh: vec![0.0; 3 * which.len()],
        };
        Gaussians::from_host(host, &g.means.val().device())
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

#[cfg(test)]
mod tests {
    use super::super::SceneSpec;
    use super::*;
    use crate::config::types::Config;
    use crate::device::DeviceName;

    #[test]
    fn the_largest_opacity_of_some_is_that_over_all_times_of_the_whole_scene() {
        let device = DeviceName::all()[0].open().unwrap();
        let mut model = Config::default().model;
        (model.resolution, model.time_knots, model.channels, model.width, model.sh_degree) = (4, 3, 4, 8, 0);
        let n = 150;
        let gaussians = HostGaussians {
            means: (0..3 * n).map(|i| (i as f32 * 0.7).sin()).collect(),
            rotations: [1.0, 0.0, 0.0, 0.0].repeat(n),
            log_scales: vec![-3.0; 3 * n],
            opacity_logits: (0..n).map(|i| i as f32 / 30.0 - 3.0).collect(),
            sh: vec![0.0; 3 * n],
        };
        let (centre, half_size) = ([0.0; 3], [1.5; 3]);
        let mut spec = SceneSpec { model, centre, half_size, background: [1.0; 3], deformed: true, sh_degree: 0 };
        for deformed in [true, false] {
            spec.deformed = deformed;
            let scene = Scene::new(gaussians.clone(), spec.clone(), 3, &device);
            let asked: Vec<bool> = (0..n).map(|i| i % 3 == 1).collect();
            let found = scene.largest_opacity(&asked);
            for i in 0..n {
                let over_time = (0..11).map(|k| scene.host_at(k as f32 / 10.0).opacity()[i]);
                let want = if asked[i] { over_time.fold(0.0, f32::max) } else { 0.0 };
                assert_eq!(found[i], want, "{i}");
            }
            assert!(scene.largest_opacity(&vec![false; n]).iter().all(|o| *o == 0.0));
        }
    }
}
