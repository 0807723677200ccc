//! A method without Gaussians: a small network from the camera's direction, the time and a pixel to the pixel's colour.

use std::path::Path;
use volseggs::burn; // for the derive
use volseggs::burn::module::{Module, Param};
use volseggs::burn::tensor::activation::sigmoid;
use volseggs::burn::tensor::{Device, Tensor, TensorData};
use volseggs::config::types::Config;
use volseggs::data::Dataset;
use volseggs::extend::{Method, Model, Network, PinholeCamera, StepInput, Training, network};
use volseggs::model::{SceneError, ToKernel};
use volseggs::rng::{Purpose, Rng};
use volseggs::train::TrainError;

/// Direction to the camera, time, column and row.
const INPUTS: usize = 6;

/// The method. `method_settings.width`, `.steps` and `.rate` are its settings.
#[derive(Clone, Copy, Debug)]
pub struct Pixels;

/// Two layers: `sigmoid(sin(x A + a) B + b)`.
#[derive(Module, Debug)]
pub struct Layers {
    hidden_weight: Param<Tensor<2>>,
    hidden_bias: Param<Tensor<1>>,
    output_weight: Param<Tensor<2>>,
    output_bias: Param<Tensor<1>>,
}

fn setting(config: &Config, name: &str, default: f64) -> f64 {
    config.method_settings.get(name).copied().unwrap_or(default)
}

impl Layers {
    /// Returns the colours `[H, W, 3]` of all pixels of a view.
    fn colours(&self, camera: &PinholeCamera, time: f32) -> Tensor<3> {
        let (eye, [h, w]) = (camera.position(), [camera.height, camera.width]);
        let length = eye.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-6);
        let rows = (0..h * w).flat_map(|i| {
            let place = |at: usize, size: usize| 2.0 * (at as f32 + 0.5) / size as f32 - 1.0;
            let [x, y, z] = eye.map(|v| v / length);
            [x, y, z, 2.0 * time - 1.0, place(i % w, w), place(i / w, h)]
        });
        let data = TensorData::new(rows.collect::<Vec<f32>>(), [h * w, INPUTS]);
        let x = Tensor::<2>::from_data(data, &self.hidden_weight.device());
        let hidden = (x.matmul(self.hidden_weight.val()) + self.hidden_bias.val().unsqueeze()).sin();
        sigmoid(hidden.matmul(self.output_weight.val()) + self.output_bias.val().unsqueeze()).reshape([h, w, 3])
    }
}

impl Method for Pixels {
    fn check(&self, config: &Config) -> Result<(), String> {
        let is_whole = |name: &str| setting(config, name, 1.0) >= 1.0 && setting(config, name, 1.0).fract() == 0.0;
        match ["width", "steps"].into_iter().find(|name| !is_whole(name)) {
            Some(name) => Err(format!("method_settings.{name}: must be a whole number, 1 or above")),
            None => Ok(()),
        }
    }

    fn steps(&self, config: &Config) -> usize {
        setting(config, "steps", 2000.0) as usize
    }

    fn start(&self, config: &Config, dataset: &Dataset, device: &Device) -> Result<Box<dyn Training>, TrainError> {
        network::start(self, config, dataset, device)
    }

    fn open(&self, path: &Path, device: &Device) -> Result<Box<dyn Model>, SceneError> {
        network::open(self, path, device)
    }
}

impl Network for Pixels {
    type Module = Layers;
    /// Its width: all that its file stores besides the tensors.
    type Spec = usize;

    fn spec(&self, config: &Config, _: &Dataset) -> usize {
        setting(config, "width", 64.0) as usize
    }

    fn parameters(&self, width: &usize) -> Result<u128, String> {
        match *width as u128 {
            0 => Err("width = 0: at least 1".into()),
            width => Ok((INPUTS as u128 + 1 + 3).saturating_mul(width).saturating_add(3)),
        }
    }

    fn network(&self, width: &usize, seed: u64, device: &Device) -> Layers {
        let mut rng = Rng::new(seed, 0, Purpose::Custom(1));
        let mut weight = |inputs: usize, outputs: usize, size: f32| {
            let values: Vec<f32> = (0..inputs * outputs).map(|_| size * rng.normal()).collect();
            Param::from_tensor(Tensor::<2>::from_data(TensorData::new(values, [inputs, outputs]), device))
        };
        Layers {
            hidden_weight: weight(INPUTS, *width, 4.0),
            output_weight: weight(*width, 3, (*width as f32).powf(-0.5)),
            hidden_bias: Param::from_tensor(Tensor::zeros([*width], device)),
            output_bias: Param::from_tensor(Tensor::zeros([3], device)),
        }
    }

    /// Returns the mean squared error of one view.
    fn loss(&self, network: &Layers, seen: &StepInput<'_, usize>) -> [Tensor<1>; 2] {
        let (images, views) = (&seen.split.images, seen.split.frames.len());
        let view = Rng::new(seen.config.seed, seen.step as u64, Purpose::Custom(2)).below(views);
        let frame = &seen.split.frames[view];
        let (h, w) = (images.height as usize, images.width as usize);
        let mut truth = vec![0.0; 3 * h * w];
        images.composite(view, seen.background, &mut truth);
        let truth = Tensor::<3>::from_data(TensorData::new(truth, [h, w, 3]), seen.device);
        let error = network.colours(&frame.camera.to_kernel(), frame.time as f32) - truth;
        let squared = error.powi_scalar(2).mean();
        [squared.clone(), squared]
    }

    fn rate(&self, _: &str, _: usize, config: &Config) -> Option<f64> {
        Some(setting(config, "rate", 5e-3))
    }

    /// Renders with an alpha of 1 everywhere, as it is not learnt.
    fn image(&self, network: &Layers, _: &usize, camera: PinholeCamera, time: f32) -> Tensor<3> {
        let colours = network.colours(&camera, time);
        let alpha = Tensor::ones([camera.height, camera.width, 1], &colours.device());
        Tensor::cat(vec![colours, alpha], 2)
    }
}
