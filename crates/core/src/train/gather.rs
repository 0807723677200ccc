//! Statistics for densification, gathered where that is cheap: on the host for devices in its memory, on the device for
//! one that runs ahead of the host, where they stay until they are read.

use super::densify::Statistics;
use crate::model::params::to_vec;
use burn::tensor::{Int, Tensor};
use volseggs_kernels::splat::ViewSums;

/// Statistics on the host and on the device.
#[derive(Clone, Debug)]
pub struct GatheredStatistics {
    host: Statistics,
    on_device: bool,
    /// Sums on the device since the last [`GatheredStatistics::replace`].
    waiting: Option<ViewSums>,
}

/// Contribution of one step, without gradients.
pub struct ViewContribution {
    /// Gradient of the screen positions `[N, 2]`, if there was one.
    pub screen: Option<Tensor<2>>,
    /// Radii `[N]`, 0 if not drawn.
    pub radii: Tensor<1, Int>,
    /// Opacity logits `[N]` as drawn.
    pub logits: Tensor<1>,
    /// Width and height of the image.
    pub size: [usize; 2],
}

impl GatheredStatistics {
    /// Returns empty statistics for `n` Gaussians.
    pub fn new(n: usize, on_device: bool) -> Self {
        Self::from(Statistics::new(n), on_device)
    }

    /// Continues from `host`.
    pub fn from(host: Statistics, on_device: bool) -> Self {
        Self { host, on_device, waiting: None }
    }

    /// Adds a view.
    pub fn add(&mut self, view: ViewContribution) {
        if !self.on_device {
            let screen = view.screen.map(to_vec).unwrap_or_default();
            let radii: Vec<i32> = view.radii.into_data().convert::<i32>().try_into_vec().unwrap_or_default();
            self.host.add_view(&screen, &radii, view.size[0], view.size[1]);
            self.host.add_opacity(&to_vec(view.logits));
            return;
        }
        let zeros = || view.logits.zeros_like();
        let sums =
            self.waiting.take().unwrap_or_else(|| ViewSums { gradient: zeros(), views: zeros(), opacity: zeros() });
        // without a gradient the host counts no view either
        let (screen, radii) = match view.screen {
            Some(screen) => (screen, view.radii),
            None => (Tensor::zeros([view.radii.dims()[0], 2], &view.logits.device()), view.radii.zeros_like()),
        };
        self.waiting = Some(sums.add(screen, radii, view.logits, view.size));
    }

    /// Returns all statistics gathered so far; waits for the device if it holds some.
    pub fn to_host(&self) -> Statistics {
        let mut host = self.host.clone();
        if let Some(w) = &self.waiting {
            let add = |to: &mut Vec<f32>, from: &Tensor<1>, join: fn(f32, f32) -> f32| {
                to.iter_mut().zip(to_vec(from.clone())).for_each(|(a, b)| *a = join(*a, b));
            };
            add(&mut host.gradient, &w.gradient, |a, b| a + b);
            add(&mut host.views, &w.views, |a, b| a + b);
            add(&mut host.opacity, &w.opacity, f32::max);
        }
        host
    }

    /// Replaces all statistics by the result of `f`.
    pub fn replace(&mut self, f: impl FnOnce(Statistics) -> Statistics) {
        self.host = f(self.to_host());
        self.waiting = None;
    }
}

#[cfg(test)]
#[cfg(any(feature = "wgpu", feature = "cuda"))]
mod tests {
    use super::*;
    use crate::device::DeviceName;
    use burn::tensor::Device;

    fn both_sides_gather_the_same(gpu: Device) {
        let view = |k: f32, device: &Device| ViewContribution {
            screen: (k != 3.0).then(|| Tensor::from_floats([[3.0 * k, 4.0], [1.0, k]], device)),
            radii: Tensor::from_ints([2, i32::from(k > 1.0)], device),
            logits: Tensor::from_floats([k - 1.0, -k], device),
            size: [20, 10],
        };
        let run = |on_device: bool, device: &Device| {
            let mut g = GatheredStatistics::new(2, on_device);
            for k in 0..4 {
                g.add(view(k as f32, device));
                if k == 1 {
                    g.replace(|s| s);
                }
            }
            g.to_host()
        };
        let cpu = DeviceName::all()[0].open().unwrap();
        let (host, device) = (run(false, &cpu), run(true, &gpu));
        let near = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5 * a.abs().max(1.0));
        assert_eq!(host.gradient.len(), device.gradient.len());
        assert!(near(&host.gradient, &device.gradient) && near(&host.opacity, &device.opacity), "{host:?} {device:?}");
        assert_eq!(host.views, device.views);
    }

    volseggs_testing::on_every_gpu!(crate::device::open_to_test => both_sides_gather_the_same);
}
