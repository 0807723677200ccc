//! A scene at one time, on the host.

use super::Scene;
use super::gaussians::Gaussians;
use super::host::HostGaussians;
use super::params::to_vec;
use volseggs_kernels::activation::sigmoid;
use volseggs_kernels::splat::SplatInputs;

/// Some Gaussians of a scene, ready to be looked at at many times. All are grey: the deformation does not look at colours.
#[derive(Debug)]
pub struct SomeGaussians<'a> {
    scene: &'a Scene,
    rows: Gaussians,
}

impl SomeGaussians<'_> {
    /// These Gaussians at `time` in [0, 1].
    #[must_use]
    pub fn at(&self, time: f32) -> HostGaussians {
        HostGaussians::from_splat(self.inputs(time))
    }

    fn inputs(&self, time: f32) -> SplatInputs {
        if self.scene.spec.deformed { self.scene.field.deform(&self.rows, time, None) } else { self.rows.val() }
    }
}

impl Scene {
    /// Whether opacities may differ from time to time.
    #[must_use]
    pub fn opacity_changes(&self) -> bool {
        self.spec.deformed && self.spec.model.deform_opacity
    }

    /// The Gaussians that `which` lists, at least one.
    ///
    /// # Panics
    /// If one is not below N.
    #[must_use]
    pub fn some(&self, which: &[u32]) -> SomeGaussians<'_> {
        let g = &self.gaussians;
        let all = HostGaussians {
            means: to_vec(g.means.val()),
            rotations: to_vec(g.rotations.val()),
            log_scales: to_vec(g.log_scales.val()),
            opacity_logits: to_vec(g.opacity_logits.val()),
            sh: vec![0.0; 3 * g.count()],
            sh_stride: 1,
        };
        let rows = Gaussians::from_host(all.subset(which), &g.means.val().device());
        SomeGaussians { scene: self, rows }
    }

    /// The largest opacity over evenly spaced times of each Gaussian that is `asked` `[N]`, `[N]`; 0 for the others,
    /// which cost nothing.
    ///
    /// # Panics
    /// If `asked` is not of length N.
    #[must_use]
    pub fn largest_opacity(&self, asked: &[bool]) -> Vec<f32> {
        const TIMES: usize = 11;
        assert_eq!(asked.len(), self.gaussians.count(), "asked: [N]");
        let which: Vec<u32> = (0..asked.len() as u32).filter(|&i| asked[i as usize]).collect();
        let mut out = vec![0.0; asked.len()];
        if which.is_empty() {
            return out;
        }
        let some = self.some(&which);
        let mut largest = vec![f32::NEG_INFINITY; which.len()];
        for k in 0..if self.opacity_changes() { TIMES } else { 1 } {
            let at = some.inputs(k as f32 / (TIMES - 1) as f32).opacity_logits;
            largest.iter_mut().zip(to_vec(at)).for_each(|(a, b)| *a = a.max(b));
        }
        which.iter().zip(largest).for_each(|(&i, logit)| out[i as usize] = sigmoid(logit));
        out
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
    fn some_gaussians_are_as_in_the_whole_scene_and_so_is_their_largest_opacity() {
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
            let (which, all) = ([3, 50, 149], scene.host_at(0.3));
            let some = scene.some(&which).at(0.3);
            assert_eq!(
                (&some.means, &some.opacity_logits),
                (&all.subset(&which).means, &all.subset(&which).opacity_logits)
            );
        }
    }
}
