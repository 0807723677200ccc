//! The rays of a step and their samples.

use super::grid::{BatchTimes, mixture, neighbours};
use super::model::VisNerf;
use super::rays::RayCamera;
use crate::pixels::{Pixel, PixelEpochs};
use burn::tensor::Device;
use volseggs_base::rng::{Purpose, Rng};
use volseggs_core::model::ToKernel;
use volseggs_kernels::march::{Ray, Samples, sample};
use volseggs_volume::data::Split;

/// Number of pixels tried for each ray, as its ray may miss the box; after that the ray is omitted.
const TRIES: usize = 16;

/// Rays of all views, with their target colours.
#[derive(Debug)]
pub(super) struct RayBatch {
    pub rays: Vec<Ray>,
    /// Positions in the box, and the ray of each.
    pub samples: Samples,
    /// Colours `[R, 3]` over the background.
    pub colours: Vec<f32>,
    /// Scene units between samples.
    pub step: f32,
    /// The time of each ray, as an index of `mixtures`.
    of_rays: Vec<i32>,
    /// The training times that occur.
    mixtures: Vec<Vec<f32>>,
}

impl RayBatch {
    /// Draws the rays of a step, each with a random offset of its samples.
    pub fn draw(model: &VisNerf, split: &Split, pixels: &PixelEpochs, step: usize, seed: u64) -> Self {
        let spec = &model.spec;
        let times = split.times();
        let mixtures: Vec<Vec<f32>> = times.iter().map(|time| mixture(spec.knots, spec.part(*time))).collect();
        let knots: Vec<[usize; 2]> = times.iter().map(|time| neighbours(spec.knots, spec.part(*time))).collect();
        let of_view = |time: f64| times.partition_point(|t| *t < time);
        let views: Vec<(RayCamera, usize)> =
            split.frames.iter().map(|f| (RayCamera::new(f.camera.to_kernel()), of_view(f.time))).collect();
        let all = split.images.width as usize * split.images.height as usize;
        let bounds = spec.bounds();
        let mut rng = Rng::new(seed, step as u64, Purpose::MethodJitter);
        let mut batch = Self {
            rays: Vec::new(),
            samples: Samples::default(),
            colours: Vec::new(),
            step: 0.0,
            of_rays: Vec::new(),
            mixtures,
        };
        let mut longest = 0.0f32;
        for mut pixel in pixels.of_step(step, spec.config.batch) {
            for _ in 0..TRIES {
                let (camera, time) = &views[pixel.view];
                let ray = camera.ray(pixel.at, 0.0);
                if let Some([enter, leave]) = bounds.chord(&ray) {
                    longest = longest.max(leave - enter);
                    batch.rays.push(Ray { jitter: rng.uniform(), ..ray });
                    batch.of_rays.push(*time as i32);
                    batch.colours.extend(split.images.pixel(pixel.view, pixel.at, spec.background));
                    break;
                }
                pixel = Pixel { view: rng.below(views.len()), at: rng.below(all) };
            }
        }
        let most = samples_of(model, step);
        batch.step = longest / most as f32;
        if !batch.rays.is_empty() {
            let keep = |ray: usize, point| model.occupancy.holds(knots[batch.of_rays[ray] as usize], point);
            batch.samples = sample(&batch.rays, bounds, batch.step, most, keep);
        }
        batch
    }

    /// The ray of each sample.
    pub fn rays_of_samples(&self) -> Vec<usize> {
        let counts = self.samples.offsets.windows(2).map(|ends| (ends[1] - ends[0]) as usize);
        counts.enumerate().flat_map(|(ray, n)| std::iter::repeat_n(ray, n)).collect()
    }

    /// The times of samples of these rays.
    pub fn times(&self, rays: impl Iterator<Item = usize>, device: &Device) -> BatchTimes {
        let of_points: Vec<i32> = rays.map(|ray| self.of_rays[ray]).collect();
        BatchTimes::new(&self.mixtures, &of_points, device)
    }
}

/// Number of samples along the longest ray of a step.
fn samples_of(model: &VisNerf, step: usize) -> usize {
    let config = &model.spec.config;
    let part = (step as f64 / config.samples_until.max(1) as f64).min(1.0);
    let (first, last) = (config.samples_first as f64, config.samples_last as f64);
    (first + part * (last - first)).round() as usize
}
