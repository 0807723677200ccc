//! Tests of [`Trainer`] on a dataset of a few small views.

use super::schedule::{Stage, learning_rate};
use super::{InPlace, SavedTraining, TrainError, Trainer, Training, losses};
use crate::config::layers::Layers;
use crate::config::types::{Config, GridInit, ShBands, TvOrder, TvReduction};
use crate::config::{PRESETS, preset};
use crate::data::Dataset;
use crate::data::dataset::OpenOptions;
use crate::data::fixture::write_sphere_dataset;
use crate::device::DeviceName;
use crate::model::encoder::Encoder;
use crate::model::params::{self, to_vec};
use crate::model::{Scene, ToKernel};
use burn::tensor::Tensor;

/// 200 Gaussians, no warm-up, and a loss of colours and alpha only.
fn config() -> Config {
    let mut config = preset("best").unwrap();
    config.model.encoder = "factorised".into();
    (config.init.points, config.model.sh_bands, config.model.sh_degree) = (200, ShBands::All, 1);
    (config.model.resolution, config.model.channels, config.model.width) = (8, 8, 16);
    (config.stages.warmup_steps, config.stages.joint_steps) = (0, 40);
    (config.loss.tv, config.loss.tv_time, config.loss.dssim) = (0.0, 0.0, 0.0);
    config
}

fn trainer(config: &Config) -> (Dataset, Trainer) {
    let folder = tempfile::tempdir().unwrap();
    write_sphere_dataset(folder.path(), 6, 16).unwrap();
    let data = Dataset::open(folder.path(), &OpenOptions::default()).unwrap();
    let device = DeviceName::all()[0].open().unwrap();
    let trainer = Trainer::new(config.clone(), &data, &device).unwrap();
    (data, trainer)
}

/// Returns the gradients of planes, lines and temporal vectors for the photometric loss of one view, before any step.
fn encoder_gradients(config: &Config) -> [Vec<f32>; 3] {
    let (data, mut trainer) = trainer(config);
    trainer.scene.spec.deformed = true;
    let scene = trainer.scene();
    let frame = &data.train.frames[0];
    let view = scene.draw(scene.deformed(frame.time as f32), frame.camera.to_kernel(), [1.0; 3], None);
    let target = Tensor::zeros(view.image.dims(), &view.image.device());
    let gradients = losses::photometric(view.image, target, &config.loss).loss.backward();
    let Encoder::Factorised(encoder) = &scene.field.encoder else { unreachable!("the default") };
    [&encoder.planes, &encoder.lines, &encoder.times].map(|p| to_vec(p.val().grad(&gradients).unwrap()))
}

fn grid(trainer: &Trainer) -> Vec<f32> {
    let tensors = params::collect(trainer.scene());
    let of_encoder = tensors.iter().filter(|(name, _)| name.starts_with("field.encoder"));
    of_encoder.flat_map(|(_, t)| t.values.clone()).collect()
}

#[test]
fn a_grid_of_zeros_has_no_gradient_and_one_away_from_it_has() {
    let nonzero = |config: &Config| encoder_gradients(config).map(|g| g.iter().filter(|v| **v != 0.0).count());
    let mut zeros = config();
    zeros.model.grid_init = GridInit::Zero;
    assert_eq!(nonzero(&zeros), [0; 3]);
    zeros.model.zero_init_heads = false;
    assert_eq!(nonzero(&zeros), [0; 3], "a dead saddle whatever the decoder");

    let counts = nonzero(&config());
    // temporal vectors: only the knot at time 0, 8 channels on 2 levels
    assert!(counts[0] > 100 && counts[1] > 100 && counts[2] >= 16, "{counts:?}");
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
    // nor does total variation of either kind move it away from zero
    (zeros.loss.tv, zeros.loss.tv_time) = (1e-4, 1e-2);
    for (kind, reduction) in [(TvOrder::Second, TvReduction::Mean), (TvOrder::First, TvReduction::Sum)] {
        (zeros.loss.tv_kind, zeros.loss.tv_reduction) = (kind, reduction);
        assert!(after(&zeros).iter().all(|v| *v == 0.0), "{kind:?}");
    }
    (zeros.loss.tv, zeros.loss.tv_time) = (0.0, 0.0);
    zeros.loss.one_prior = 0.01;
    assert!(after(&zeros).iter().all(|v| *v > 0.0));
}

#[test]
fn a_static_scene_is_trained_without_a_joint_stage() {
    let folder = tempfile::tempdir().unwrap();
    write_sphere_dataset(folder.path(), 8, 16).unwrap();
    let steps = 240;
    let sets = [
        "init.points=200",
        "stages.warmup_steps=240",
        "stages.sh_every=60",
        "loss.dssim_last=240",
        "optim.warmup_decay_steps=240",
        "densify.mode=budget",
        "densify.budget=333",
        "densify.every=20",
        "densify.warmup_from=40",
        "densify.warmup_until=130",
        "densify.opacity_reset=0",
        "densify.opacity_reset_until=0",
        "densify.prune_size=0",
        "data.only_times=[0.9]",
    ];
    let config = Layers::new(PRESETS).source("static").sets(sets).resolve::<Config>().unwrap().value;
    let data = super::open_dataset(folder.path(), &config).unwrap();
    assert_eq!((data.train.times(), data.train.frames.len()), (vec![1.0], 4));
    let device = DeviceName::all()[0].open().unwrap();
    let mut trainer = Trainer::new(config.clone(), &data, &device).unwrap();
    let reports: Vec<_> = (0..steps).map(|_| trainer.step(&data.train).unwrap()).collect();
    let mean = |from: usize, to: usize| reports[from..to].iter().map(|r| r.psnr).sum::<f64>() / (to - from) as f64;
    assert!(mean(220, 240) > mean(0, 20) + 3.0, "{} dB, then {} dB", mean(0, 20), mean(220, 240));
    let counts: Vec<usize> = reports.iter().map(|r| r.primitives).collect();
    assert_eq!((counts[129] < 333, counts[130], counts[239]), (true, 333, 333), "the line ends with warmup_until");
    let rate = |step: usize| learning_rate("gaussians.means", Stage::from_step(step, &config), &config, 1.0).unwrap();
    assert!((rate(120) / rate(0) - 0.1).abs() < 1e-12 && rate(239) / rate(0) < 0.011);
    let scene = trainer.scene();
    assert!(!scene.spec.deformed && scene.spec.sh_degree == 3);
    let means = |time: f32| to_vec(scene.deformed(time).means);
    assert_eq!(means(0.0), means(1.0));
}

#[test]
fn the_weight_of_the_distance_scales_it() {
    let loss = |weight: f64| {
        let mut config = config();
        config.loss.weight = weight;
        let (data, mut trainer) = trainer(&config);
        trainer.step(&data.train).unwrap().loss
    };
    assert!((loss(0.8) / loss(1.0) - 0.8).abs() < 1e-6);
}

#[test]
fn every_layer_of_the_implicit_encoder_is_trained() {
    let mut config = config();
    (config.model.encoder, config.model.implicit_width, config.optim.encoder) = ("implicit".into(), 24, 1e-3);
    let (data, mut trainer) = trainer(&config);
    let start = params::collect(trainer.scene());
    let losses: Vec<f64> = (0..30).map(|_| trainer.step(&data.train).unwrap().loss).collect();
    let end = params::collect(trainer.scene());
    let layers: Vec<&String> = end.keys().filter(|name| name.starts_with("field.encoder.Implicit.layers")).collect();
    assert_eq!(layers.len(), 2 * config.model.implicit_depth);
    for name in layers {
        assert_ne!(start[name], end[name], "{name}");
    }
    // sums over several views, as each step sees a different one
    assert!(losses[24..].iter().sum::<f64>() < losses[..6].iter().sum(), "{losses:?}");
}

#[test]
fn a_loss_that_is_not_finite_stops_training() {
    let (data, mut trainer) = trainer(&config());
    trainer.config.loss.alpha = 1e300; // the checks would refuse it; infinite in f32
    let before = params::collect(trainer.scene());
    match trainer.step(&data.train) {
        Err(TrainError::NotFinite { step: 0, what }) => assert!(what.contains("the loss"), "{what}"),
        other => panic!("{other:?}"),
    }
    assert_eq!((trainer.steps_done(), params::collect(trainer.scene())), (0, before));
}

#[test]
fn a_rate_or_weight_that_is_not_finite_or_negative_is_refused_by_name() {
    let (data, _) = trainer(&config());
    type Poison = fn(&mut Config);
    let cases: [(Poison, &str); 3] = [
        (|c| c.loss.alpha = f64::NAN, "loss.alpha"),
        (|c| c.optim.means = -1.0, "optim.means"),
        (|c| c.optim.betas[1] = f64::INFINITY, "optim.betas"),
    ];
    for (poison, key) in cases {
        let mut config = config();
        poison(&mut config);
        let device = DeviceName::Flex.open().unwrap();
        match Trainer::new(config, &data, &device) {
            Err(TrainError::Config(text)) => assert!(text.contains(key), "{text}"),
            other => panic!("{key}: {other:?}"),
        }
    }
}

#[test]
fn a_nan_in_a_parameter_stops_training_and_is_named() {
    let (data, clean) = trainer(&config());
    for name in params::collect(clean.scene()).keys() {
        let (_, mut trainer) = trainer(&config());
        for _ in 0..2 {
            trainer.step(&data.train).unwrap();
        }
        let mut tensors = params::collect(trainer.scene());
        let values = &mut tensors.get_mut(name).unwrap().values;
        let middle = values.len() / 2;
        values[middle] = f32::NAN;
        trainer.scene = InPlace::new(params::load(trainer.scene().clone(), &tensors).unwrap());
        match trainer.step(&data.train) {
            Err(TrainError::NotFinite { step: 2, what }) => assert!(what.contains(name), "{name}: {what}"),
            other => panic!("{name}: {other:?}"),
        }
    }
}

#[test]
fn sorting_moves_gaussians_with_their_moments_and_changes_nothing_else() {
    let losses = |sort_every: usize| {
        let mut config = config();
        config.speed.sort_every = sort_every;
        let (data, mut trainer) = trainer(&config);
        (0..12).map(|_| trainer.step(&data.train).unwrap().loss).collect::<Vec<_>>()
    };
    let (plain, sorted) = (losses(0), losses(3));
    for (a, b) in plain.iter().zip(&sorted) {
        assert!((a - b).abs() < 1e-3 * a.abs(), "{plain:?} {sorted:?}");
    }
    assert!(plain.last() < plain.first());
}

#[test]
fn the_first_steps_may_see_reduced_images() {
    let mut config = config();
    (config.speed.coarse_steps, config.speed.coarse_factor) = (3, 4);
    let (data, mut trainer) = trainer(&config);
    for step in 0..6 {
        let coarse = trainer.coarse.as_ref().map(|s| (s.images.width, s.frames[0].camera.width));
        assert_eq!(coarse, (step <= 3).then_some((4, 4)), "step {step}");
        assert!(trainer.step(&data.train).unwrap().loss.is_finite());
    }
    config.speed.coarse_factor = 5;
    let device = DeviceName::all()[0].open().unwrap();
    let refused = Trainer::new(config, &data, &device).unwrap_err().to_string();
    assert!(refused.contains('5') && refused.contains("16x16"), "{refused}");
}

#[test]
fn skipping_transparent_gaussians_changes_little_and_lets_them_return() {
    let run = |cull_visits: usize| {
        let mut config = config();
        config.speed.cull_visits = cull_visits;
        (config.speed.sort_every, config.optim.opacity) = (0, 0.0);
        let (data, mut trainer) = trainer(&config);
        // two thirds start transparent, and only the field can change that
        let mut host = trainer.scene().gaussians.to_host();
        (0..200).filter(|i| i % 3 > 0).for_each(|i| host.opacity_logits[i] = -9.0);
        trainer.replace_gaussians(host);
        let losses = (0..24).map(|_| trainer.step(&data.train).unwrap().loss).collect::<Vec<_>>();
        (losses, trainer.culling.to_tensors())
    };
    let ((plain, none), (culled, kept)) = (run(0), run(4));
    assert!(none.is_empty() && !kept.is_empty());
    let counted = kept.values().map(|t| t.values[1..].iter().map(|v| (*v as u32).count_ones()).sum::<u32>());
    assert!(counted.clone().all(|n| (100..=140).contains(&n)), "{:?}", counted.collect::<Vec<_>>());
    for (a, b) in plain.iter().zip(&culled) {
        assert!((a - b).abs() < 1e-3 * a.abs(), "{plain:?} {culled:?}");
    }
}

#[test]
fn an_average_changes_no_step_is_sorted_along_and_is_restored_from_a_checkpoint() {
    let of = |average: usize| {
        let mut config = config();
        (config.optim.average, config.speed.sort_every, config.stages.joint_steps) = (average, 15, 130);
        trainer(&config)
    };
    let ((data, mut plain), (_, mut averaged)) = (of(0), of(20));
    for step in 0..114 {
        plain.step(&data.train).unwrap();
        averaged.step(&data.train).unwrap();
        assert_eq!(averaged.ema.scene().is_some(), step >= 9);
    }
    assert_eq!(params::collect(averaged.scene()), params::collect(plain.scene()));
    let mean = |trainer: &Trainer| to_vec(trainer.shown().gaussians.means.val());
    let apart = mean(&plain).iter().zip(mean(&averaged)).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(apart > 0.0 && apart < 0.02, "sorting Gaussians did not also sort the average: {apart}");

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.safetensors");
    averaged.model().save(&path).unwrap();
    let (_, mut resumed) = of(20);
    let state = averaged.state();
    resumed.resume(SavedTraining { model: &path, state, state_path: &path, step: 114, first_primitives: 200 }).unwrap();
    for _ in 0..8 {
        averaged.step(&data.train).unwrap();
        resumed.step(&data.train).unwrap();
    }
    for [a, b] in [[averaged.scene(), resumed.scene()], [averaged.shown(), resumed.shown()]] {
        assert_eq!(params::collect(a), params::collect(b));
    }
    assert_eq!(averaged.state(), resumed.state());
}

#[test]
fn a_run_lengthened_by_a_joint_stage_begins_a_new_average_with_it() {
    let with_joint = |joint_steps: usize| {
        let mut config = config();
        (config.optim.average, config.stages.warmup_steps, config.stages.joint_steps) = (20, 60, joint_steps);
        (config.densify.mode, config.densify.budget, config.densify.prune_opacity) = ("off".into(), 200, 0.0);
        trainer(&config)
    };
    let (data, mut short) = with_joint(0);
    let steps = short.total_steps();
    for _ in 0..steps {
        short.step(&data.train).unwrap();
    }
    let means = |scene: &Scene| to_vec(scene.gaussians.means.val());
    assert_ne!(means(short.shown()), means(short.scene()), "its average is of many steps");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.safetensors");
    short.model().save(&path).unwrap();
    let (_, mut longer) = with_joint(10);
    let (state, state_path) = (short.state(), path.as_path());
    longer.resume(SavedTraining { model: &path, state, state_path, step: steps, first_primitives: 200 }).unwrap();
    assert_eq!(means(longer.scene()), means(short.scene()));
    assert_eq!(means(longer.shown()), means(short.scene()), "the average of warm-up goes on in the joint stage");
}

#[test]
fn relocation_keeps_the_number_of_gaussians_on_the_line_and_resumes_bit_identically() {
    let mut config = config();
    (config.stages.joint_steps, config.densify.mode, config.densify.budget) = (60, "relocate".into(), 240);
    (config.densify.every, config.densify.prune_every, config.densify.prune_opacity) = (5, 10, 0.05);
    (config.densify.joint_from, config.densify.joint_until) = (10, 40);
    let (data, mut whole) = trainer(&config);
    let counts: Vec<usize> = (0..25).map(|_| whole.step(&data.train).unwrap().primitives).collect();
    assert_eq!(counts[13..17], [200, 200, 207, 207], "added when the next step begins");
    assert_eq!(counts[24], 213, "it grows linearly, whatever is transparent");

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.safetensors");
    whole.model().save(&path).unwrap();
    let (_, mut resumed) = trainer(&config);
    let saved =
        SavedTraining { model: &path, state: whole.state(), state_path: &path, step: 25, first_primitives: 200 };
    resumed.resume(saved).unwrap();
    for step in 25..60 {
        let both = [&mut whole, &mut resumed].map(|trainer| trainer.step(&data.train).unwrap().primitives);
        assert!(step > 25 || both == [220, 220], "{both:?}");
        // looked at after step 30, begun anew with the additions before step 31
        assert_eq!(whole.ema.scene().is_some(), [29, 39].contains(&step) || step >= 49, "{step}");
    }
    assert_eq!(whole.scene().gaussians.count(), 240);
    assert_eq!(params::collect(whole.scene()), params::collect(resumed.scene()));
}
