//! A scene at one time, on the host.

use super::Scene;
use super::gaussians::Gaussians;
use super::host::HostGaussians;
use super::params::to_vec;
use volseggs_kernels::activation::sigmoid;

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
        let g = &self.gaussians;
        let all = HostGaussians {
            means: to_vec(g.means.val()),
            rotations: to_vec(g.rotations.val()),
            log_scales: to_vec(g.log_scales.val()),
            opacity_logits: to_vec(g.opacity_logits.val()),
            sh: vec![0.0; 3 * g.count()],
            sh_stride: 1,
            shading: None,
        };
        let host = all.map(|column| column.gather(which.iter().copied()));
        Gaussians::from_host(host, &g.means.val().device())
    }

    /// The Gaussians at `time` in [0, 1], on the host.
    #[must_use]
    pub fn host_at(&self, time: f32) -> HostGaussians {
        HostGaussians::from_splat(self.at(time))
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
            sh_stride: 1,
            shading: None,
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
