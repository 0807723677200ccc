//! A trainer on a dataset of a few small views: what the start of the grid means, and poison values.

use super::{TrainError, Trainer, losses};
use crate::config::types::{Config, GridInit};
use crate::data::Dataset;
use crate::data::dataset::{OpenOptions, tests::dataset};
use crate::device::DeviceName;
use crate::model::encoder::Encoder;
use crate::model::params::{self, to_vec};
use burn::tensor::Tensor;

/// 200 Gaussians, no warm-up, nothing but the colours and alpha in the loss.
fn config() -> Config {
    let mut config = Config::default();
    (config.init.points, config.model.sh_degree) = (200, 1);
    (config.model.resolution, config.model.channels, config.model.width) = (8, 8, 16);
    (config.stages.warmup_steps, config.stages.joint_steps) = (0, 40);
    (config.loss.tv, config.loss.tv_time, config.loss.dssim) = (0.0, 0.0, 0.0);
    config
}

fn trainer(config: &Config) -> (Dataset, Trainer) {
    let folder = dataset(6, 16);
    let data = Dataset::open(folder.path(), &OpenOptions::default()).unwrap();
    let device = DeviceName::all()[0].open().unwrap();
    let trainer = Trainer::new(config.clone(), &data, &device).unwrap();
    (data, trainer)
}

/// Gradients of planes, lines and temporal vectors of one view's colours, before any step.
fn encoder_gradients(config: &Config) -> [Vec<f32>; 3] {
    let (data, mut trainer) = trainer(config);
    let scene = trainer.scene.as_mut().unwrap();
    scene.spec.deformed = true;
    let frame = &data.train.frames[0];
    let view = scene.draw(scene.at(frame.time as f32), frame.camera.to_kernel(), [1.0; 3], None);
    let target = Tensor::zeros(view.image.dims(), &view.image.device());
    let gradients = losses::photometric(view.image, target, &config.loss).backward();
    let Encoder::Factorised(encoder) = &scene.field.encoder else { unreachable!("the default") };
    [&encoder.planes, &encoder.lines, &encoder.times].map(|p| to_vec(p.val().grad(&gradients).unwrap()))
}

fn grid(trainer: &Trainer) -> Vec<f32> {
    let tensors = params::collect(trainer.scene());
    let of_encoder = tensors.iter().filter(|(name, _)| name.starts_with("field.encoder"));
    of_encoder.flat_map(|(_, t)| t.values.clone()).collect()
}

#[test]
fn a_grid_of_zeros_has_no_gradient_and_the_default_has() {
    let nonzero = |config: &Config| encoder_gradients(config).map(|g| g.iter().filter(|v| **v != 0.0).count());
    let mut zeros = config();
    zeros.model.grid_init = GridInit::Zero;
    assert_eq!(nonzero(&zeros), [0; 3]);
    zeros.model.zero_init_heads = false;
    assert_eq!(nonzero(&zeros), [0; 3], "a dead saddle whatever the decoder");

    let counts = nonzero(&config());
    assert!(counts.iter().all(|&n| n > 100), "{counts:?}");
    assert!(encoder_gradients(&config()).iter().flatten().all(|v| v.is_finite()));
}

#[test]
fn a_grid_of_zeros_is_learnt_only_with_the_prior() {
    let mut zeros = config();
    zeros.model.grid_init = GridInit::Zero;
    let after = |config: &Config| {
        let (data, mut trainer) = trainer(config);
        for _ in 0..5 {
            trainer.step(&data.train).unwrap();
        }
        grid(&trainer)
    };
    assert!(after(&zeros).iter().all(|v| *v == 0.0));
    zeros.loss.one_prior = 0.01;
    assert!(after(&zeros).iter().all(|v| *v > 0.0));
}

#[test]
fn a_nan_stops_training_and_is_named() {
    let (data, clean) = trainer(&config());
    let names: Vec<String> = params::collect(clean.scene()).into_keys().collect();
    for name in &names {
        let (_, mut trainer) = trainer(&config());
        for _ in 0..2 {
            trainer.step(&data.train).unwrap();
        }
        let scene = trainer.scene.take().unwrap();
        let mut tensors = params::collect(&scene);
        let values = &mut tensors.get_mut(name).unwrap().values;
        let middle = values.len() / 2;
        values[middle] = f32::NAN;
        trainer.scene = Some(params::load(scene, &tensors).unwrap());
        for k in 0..3 {
            let r = trainer.step(&data.train).map(|r| (r.loss, r.psnr));
            println!("PROBE {name} {k}: {:?}", r.map_err(|e| e.to_string()));
        }
    }
}
