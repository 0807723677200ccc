//! A scene at one time, on the host.

use super::Scene;
use super::embedding::HostEmbedding;
use super::gaussians::Gaussians;
use super::host::HostGaussians;
use super::params::to_vec;
use burn::tensor::Tensor;
use volseggs_kernels::activation::sigmoid;
use volseggs_kernels::splat::SplatInputs;

/// Some Gaussians of a scene, prepared for evaluation at many times. All are grey: the deformation ignores colours.
#[derive(Debug)]
pub struct SomeGaussians<'a> {
    scene: &'a Scene,
    rows: Gaussians,
}

impl SomeGaussians<'_> {
    /// These Gaussians at `time` in [0, 1].
    pub fn deformed(&self, time: f32) -> HostGaussians {
        HostGaussians::from_splat(self.inputs(time))
    }

    /// Their opacity logits at `time`.
    fn opacity_logits(&self, time: f32) -> Tensor<1> {
        let Self { scene, rows } = self;
        if scene.spec.deformed { scene.field.opacity_logits(rows, time) } else { rows.opacity_logits.val() }
    }

    fn inputs(&self, time: f32) -> SplatInputs {
        if self.scene.spec.deformed { self.scene.field.deform(&self.rows, time, None) } else { self.rows.val() }
    }
}

/// The Gaussians of a scene at other times than the one at which they are looked at.
#[derive(Clone, Debug, Default)]
pub struct OtherTimes {
    /// Positions `[N, 3]`, scene units, at each of several times; none if nothing moves.
    pub means: Vec<Vec<f32>>,
    /// Opacities `[N]` of [`Scene::opacity_at_other_times`].
    pub opacity: Vec<f32>,
}

/// Times at which positions are looked at.
const PLACES: [f32; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];

impl Scene {
    /// Positions at five evenly spaced times, and [`Self::opacity_at_other_times`].
    ///
    /// # Panics
    /// If `asked` is not of length N.
    pub fn at_other_times(&self, asked: &[bool], min_opacity: f32) -> OtherTimes {
        let opacity = self.opacity_at_other_times(asked, min_opacity);
        let all: Vec<u32> = (0..asked.len() as u32).collect();
        let means = if self.spec.deformed && !all.is_empty() {
            let all = self.subset(&all);
            PLACES.iter().map(|time| all.deformed(*time).means).collect()
        } else {
            Vec::new()
        };
        OtherTimes { means, opacity }
    }

    /// Whether opacities may change over time.
    pub fn opacity_changes(&self) -> bool {
        self.spec.deformed && self.spec.model.deform_opacity && self.spec.d3dgs.is_none()
    }

    /// The Gaussians listed in `which`, at least one.
    ///
    /// # Panics
    /// If an index is not below N.
    pub fn subset(&self, which: &[u32]) -> SomeGaussians<'_> {
        self.rows(&self.without_colour(), which)
    }

    fn rows(&self, all: &HostGaussians, which: &[u32]) -> SomeGaussians<'_> {
        let rows = Gaussians::from_host(all.subset(which), &self.gaussians.means.val().device());
        SomeGaussians { scene: self, rows }
    }

    fn without_colour(&self) -> HostGaussians {
        let g = &self.gaussians;
        let sh = Tensor::zeros([g.count(), 1, 3], &g.means.val().device());
        let plain = HostGaussians::from_splat(SplatInputs { sh, shading: None, ..g.val() });
        HostGaussians { embedding: g.embedding.as_ref().map(HostEmbedding::from_param), ..plain }
    }

    /// Opacities `[N]` of the Gaussians marked in `asked` `[N]`, each at the first of the times looked at for which it is
    /// at least `min_opacity`; 0 if there is none. These are eleven evenly spaced times, distant ones first, then the
    /// knots of the field, between which an opacity can hardly rise and fall. Unmarked Gaussians are 0 and cost nothing;
    /// a Gaussian already found is not evaluated again.
    ///
    /// # Panics
    /// If `asked` is not of length N.
    pub fn opacity_at_other_times(&self, asked: &[bool], min_opacity: f32) -> Vec<f32> {
        assert_eq!(asked.len(), self.gaussians.count(), "asked: [N]");
        let all = self.without_colour();
        let mut open: Vec<u32> = (0..asked.len() as u32).filter(|&i| asked[i as usize]).collect();
        let mut seen = vec![0.0; asked.len()];
        for time in if self.opacity_changes() { looked_at(self.spec.model.time_knots) } else { vec![0.0] } {
            if open.is_empty() {
                break;
            }
            let mut now = to_vec(self.rows(&all, &open).opacity_logits(time)).into_iter().map(sigmoid);
            open.retain(|&i| {
                let found = now.next().filter(|opacity| *opacity >= min_opacity);
                seen[i as usize] = found.unwrap_or(0.0);
                found.is_none()
            });
        }
        seen
    }

    /// The Gaussians at `time` in [0, 1], on the host.
    pub fn host_at(&self, time: f32) -> HostGaussians {
        HostGaussians::from_splat(self.deformed(time))
    }
}

/// Returns eleven evenly spaced times, then the times of `knots` knots, at most 101.
fn looked_at(knots: usize) -> Vec<f32> {
    // far apart first, so that few Gaussians soon remain open
    const TENTHS: [u8; 11] = [0, 10, 3, 7, 5, 1, 9, 2, 8, 4, 6];
    let last = knots.saturating_sub(1).min(100);
    let between = (1..last).map(|k| k as f32 / last as f32);
    TENTHS.into_iter().map(|tenths| f32::from(tenths) / 10.0).chain(between).collect()
}

#[cfg(test)]
mod tests {
    use super::super::SceneSpec;
    use super::super::fixture::spec;
    use super::*;
    use crate::config::preset;
    use crate::device::DeviceName;

    #[test]
    fn every_knot_is_looked_at() {
        for knots in [0, 1, 2, 3, 25, 101, 5000] {
            let times = looked_at(knots);
            assert!(times.len() <= 11 + 99 && times.iter().all(|t| (0.0..=1.0).contains(t)), "{knots}");
            let last = knots.clamp(2, 101) - 1;
            assert!((0..=last).all(|k| times.contains(&(k as f32 / last as f32))), "{knots}");
        }
    }

    #[test]
    fn some_gaussians_are_as_in_the_whole_scene_and_seen_if_they_are_at_any_time() {
        let device = DeviceName::all()[0].open().unwrap();
        let mut model = preset("best").unwrap().model;
        (model.resolution, model.time_knots, model.channels, model.width, model.sh_degree) = (4, 3, 4, 8, 0);
        let n = 150;
        let gaussians = HostGaussians {
            means: (0..3 * n).map(|i| (i as f32 * 0.7).sin()).collect(),
            rotations: [1.0, 0.0, 0.0, 0.0].repeat(n),
            log_scales: vec![-3.0; 3 * n],
            opacity_logits: (0..n).map(|i| i as f32 / 30.0 - 3.0).collect(),
            sh: vec![0.0; 3 * n],
            sh_stride: 1,
            ..HostGaussians::default()
        };
        let mut spec = SceneSpec { half_size: [1.5; 3], ..spec(model) };
        for deformed in [true, false] {
            spec.deformed = deformed;
            let scene = Scene::new(gaussians.clone(), spec.clone(), 3, &device);
            let asked: Vec<bool> = (0..n).map(|i| i % 3 == 1).collect();
            let found = scene.opacity_at_other_times(&asked, 0.5);
            for i in 0..n {
                let of: Vec<f32> = (0..11).map(|k| scene.host_at(k as f32 / 10.0).opacity()[i]).collect();
                let any = of.iter().any(|o| *o >= 0.5);
                assert_eq!(found[i] > 0.0, asked[i] && any, "{i}");
                assert!(found[i] == 0.0 || found[i] >= 0.5 && of.iter().any(|o| (o - found[i]).abs() < 1e-6), "{i}");
            }
            assert!(found.iter().any(|o| *o > 0.0));
            assert!(scene.opacity_at_other_times(&vec![false; n], 0.0).iter().all(|o| *o == 0.0));
            let other = scene.at_other_times(&asked, 0.5);
            let means: Vec<Vec<f32>> = PLACES.iter().map(|t| scene.host_at(*t).means).collect();
            assert_eq!((other.opacity, other.means), (found, if deformed { means } else { Vec::new() }));
            let (which, all) = ([3, 50, 149], scene.host_at(0.3));
            let some = scene.subset(&which).deformed(0.3);
            assert_eq!(
                (&some.means, &some.opacity_logits),
                (&all.subset(&which).means, &all.subset(&which).opacity_logits)
            );
        }
    }
}
