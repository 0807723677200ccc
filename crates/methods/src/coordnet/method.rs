//! The loss of a step, and the network's inputs for the pixels of a view.

use super::network::{INPUTS, OUTPUTS, SineNetwork, parameters, values_per_pixel};
use super::settings::CoordNetConfig;
use crate::network::{self, Network, StepInput};
use crate::pixels::PixelEpochs;
use crate::sphere::ViewSphere;
use crate::{Method, MethodWork, Model, Training, ignored};
use burn::module::{Module, ModuleVisitor, Param};
use burn::tensor::{Device, Tensor, TensorData};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};
use std::path::Path;
use volseggs_base::memory::{MemoryBudget, product};
use volseggs_core::config::sections::ConfigSection;
use volseggs_core::config::types::Config;
use volseggs_core::model::{SceneError, ToKernel};
use volseggs_core::train::TrainError;
use volseggs_kernels::PinholeCamera;
use volseggs_volume::data::{Dataset, Frame};

/// Number of pixels drawn at a time: hidden layers with this many rows fit into a few dozen megabytes.
const PART: usize = 32_768;

/// CoordNet, see [`super`]. Its settings are the section `[coordnet]`.
#[derive(Clone, Copy, Debug)]
pub struct CoordNet;

/// What the tensors do not determine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CoordNetSpec {
    /// The network's settings.
    pub config: CoordNetConfig,
    /// The sphere of the training cameras.
    pub sphere: ViewSphere,
}

impl Method for CoordNet {
    fn section(&self) -> Option<ConfigSection> {
        Some(ConfigSection::new::<CoordNetConfig>())
    }

    fn presets(&self) -> &'static [(&'static str, &'static str)] {
        &[
            ("coordnet", include_str!("../../../../configs/methods/coordnet.toml")),
            ("coordnet-small", include_str!("../../../../configs/methods/coordnet-small.toml")),
        ]
    }

    fn check_ignored(&self, config: &Config) -> Result<(), String> {
        ignored::without_gaussians(config)
    }

    fn check(&self, config: &Config) -> Result<(), String> {
        let settings = &config.section::<CoordNetConfig>()?;
        settings.check()?;
        // values that the autodiff tape keeps per hidden value
        let bytes = product(&[settings.batch, 3 * size_of::<f32>()]).saturating_mul(values_per_pixel(settings));
        let what = format!("coordnet.batch = {} with layers of this width", settings.batch);
        MemoryBudget::now().check(what, bytes).map_err(|e| e.to_string())
    }

    fn steps(&self, config: &Config) -> usize {
        config.section::<CoordNetConfig>().map_or(0, |settings| settings.steps)
    }

    fn work(&self, config: &Config) -> Option<MethodWork> {
        let settings = &config.section::<CoordNetConfig>().ok()?;
        let weights = parameters(settings) as f64;
        let bytes = 20.0 * weights + 12.0 * settings.batch as f64 * values_per_pixel(settings) as f64;
        Some(MethodWork::Network { step: settings.batch as f64 * weights, pixel: weights, bytes })
    }

    fn start(&self, config: &Config, dataset: &Dataset, device: &Device) -> Result<Box<dyn Training>, TrainError> {
        network::start(self, config, dataset, device)
    }

    fn open(&self, path: &Path, device: &Device) -> Result<Box<dyn Model>, SceneError> {
        network::open(self, path, device)
    }
}

impl Network for CoordNet {
    type Module = SineNetwork;
    type Spec = CoordNetSpec;

    fn spec(&self, config: &Config, dataset: &Dataset) -> CoordNetSpec {
        CoordNetSpec { config: config.section().unwrap_or_default(), sphere: ViewSphere::around(&dataset.train) }
    }

    fn parameters(&self, spec: &CoordNetSpec) -> Result<u128, String> {
        spec.config.check()?;
        spec.sphere.check()?;
        Ok(parameters(&spec.config))
    }

    fn network(&self, spec: &CoordNetSpec, seed: u64, device: &Device) -> SineNetwork {
        SineNetwork::new(&spec.config, seed, device)
    }

    /// The mean squared difference of the colours of the step's pixels, which span 2 here, plus the weight decay.
    fn loss(&self, network: &SineNetwork, seen: &StepInput<'_, CoordNetSpec>) -> [Tensor<1>; 2] {
        let (settings, images) = (&seen.spec.config, &seen.split.images);
        let size = [images.width as usize, images.height as usize];
        let view = |f: &Frame| view_inputs(&seen.spec.sphere, &f.camera.to_kernel(), f.time as f32);
        let views: Vec<[f32; 3]> = seen.split.frames.iter().map(view).collect();
        let pixels = PixelEpochs::new(views.len(), size[0] * size[1], settings.pixels_per_view, seen.config.seed);
        let n = settings.batch;
        let (mut inputs, mut colours) = (Vec::with_capacity(n * INPUTS), Vec::with_capacity(n * OUTPUTS));
        for pixel in pixels.of_step(seen.step, n) {
            inputs.extend(pixel_inputs(pixel.at, size, views[pixel.view]));
            colours.extend(images.pixel(pixel.view, pixel.at, seen.background).map(|c| 2.0 * c - 1.0));
        }
        let tensor = |values: Vec<f32>, columns| Tensor::from_data(TensorData::new(values, [n, columns]), seen.device);
        let (inputs, colours): (Tensor<2>, Tensor<2>) = (tensor(inputs, INPUTS), tensor(colours, OUTPUTS));
        let difference = (network.forward(inputs) - colours).square().mean();
        let squared = difference.clone().detach().mul_scalar(0.25);
        match settings.weight_decay {
            0.0 => [difference, squared],
            weight => [difference + squares(network).mul_scalar(0.5 * weight), squared],
        }
    }

    fn rate(&self, _: &str, _: usize, config: &Config) -> Option<f64> {
        config.section::<CoordNetConfig>().ok().map(|settings| settings.rate)
    }

    fn place(&self, spec: &CoordNetSpec) -> (DVec3, f64) {
        (spec.sphere.centre, spec.sphere.half_size)
    }

    /// Alpha is 1, as the network outputs only colours.
    fn image(&self, network: &SineNetwork, spec: &CoordNetSpec, camera: PinholeCamera, time: f32) -> Tensor<3> {
        let device = network.device();
        let size = [camera.width, camera.height];
        let view = view_inputs(&spec.sphere, &camera, time);
        let part = |first: usize| {
            let pixels = first..(first + PART).min(camera.width * camera.height);
            let n = pixels.len();
            let inputs: Vec<f32> = pixels.flat_map(|at| pixel_inputs(at, size, view)).collect();
            let inputs = Tensor::<2>::from_data(TensorData::new(inputs, [n, INPUTS]), &device);
            let colours = network.forward(inputs).add_scalar(1.0).mul_scalar(0.5);
            Tensor::cat(vec![colours, Tensor::ones([n, 1], &device)], 1)
        };
        let parts = (0..camera.width * camera.height).step_by(PART).map(part).collect();
        Tensor::<2>::cat(parts, 0).reshape([camera.height, camera.width, OUTPUTS + 1])
    }
}

/// The inputs shared by all pixels of a view: polar angle, azimuth and time, each in [-1, 1].
fn view_inputs(sphere: &ViewSphere, camera: &PinholeCamera, time: f32) -> [f32; 3] {
    let angles = sphere.angles(camera);
    let scaled = |part: f64| (2.0 * part - 1.0) as f32;
    [scaled(angles.polar / PI), scaled(angles.azimuth / TAU), scaled(f64::from(time))]
}

/// The network's inputs for pixel `at` (row-major) of an image of `[width, height]`.
pub(super) fn pixel_inputs(at: usize, [width, height]: [usize; 2], view: [f32; 3]) -> [f32; INPUTS] {
    let scaled = |index: usize, len: usize| 2.0 * index as f32 / (len.max(2) - 1) as f32 - 1.0;
    let [polar, azimuth, time] = view;
    [scaled(at % width, width), scaled(at / width, height), polar, azimuth, time]
}

/// The sum of the squares of all parameters, `[1]`; the gradient of half this sum times the decay is what PyTorch's
/// `weight_decay` adds to the gradient.
fn squares(network: &SineNetwork) -> Tensor<1> {
    struct Squares(Tensor<1>);
    impl ModuleVisitor for Squares {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            self.0 = self.0.clone() + param.val().square().sum();
        }
    }
    let mut visitor = Squares(Tensor::zeros([1], &network.device()));
    network.visit(&mut visitor);
    visitor.0
}
