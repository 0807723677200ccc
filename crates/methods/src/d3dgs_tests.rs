//! Training with the network of D3DGS: it learns, resumes bit-identically from a checkpoint, and yields a scene.

use super::Training;
use super::test_support::{ball, changed, check_checkpoint, device, parameters, stepped};
use volseggs_core::config::types::Config;
use volseggs_core::model::params::to_vec;
use volseggs_core::model::{Scene, ToKernel};
use volseggs_core::train::open_dataset;
use volseggs_volume::data::Dataset;
use volseggs_volume::data::fixture::write_sphere_dataset;

/// The small preset with few steps and few Gaussians.
fn config(more: &[&str]) -> Config {
    let few = [
        "init.points=200",
        "d3dgs.width=24",
        "stages.warmup_steps=12",
        "stages.joint_steps=40",
        "densify.budget=260",
        "densify.every=5",
        "densify.warmup_from=0",
        "densify.warmup_until=12",
        "densify.joint_until=30",
        "densify.prune_every=5",
        "d3dgs.time_noise_steps=40",
    ];
    changed("d3dgs-small", &few, more)
}

fn data() -> Dataset {
    ball(6, 16)
}

#[test]
fn every_layer_is_trained_in_the_joint_stage_alone_and_time_matters_then() {
    let (config, data) = (config(&[]), data());
    let mut training = crate::start(&config, &data, &device()).unwrap();
    let start = parameters(&*training);
    let of_network = |name: &&String| name.starts_with("field.encoder.D3dgs");
    assert_eq!(start.keys().filter(of_network).count(), 2 * (4 + 1), "four hidden layers and the outputs");
    assert!(start.keys().all(|name| name.starts_with("gaussians.") || of_network(&name)), "{:?}", start.keys());
    let losses = stepped(&mut *training, &data, 12);
    let warm = parameters(&*training);
    for name in start.keys().filter(of_network) {
        assert_eq!(start[name], warm[name], "{name} was trained in warm-up");
    }
    let means = |training: &dyn Training, time: f32| to_vec(training.model().scene().unwrap().deformed(time).means);
    assert_eq!(means(&*training, 0.0), means(&*training, 1.0));
    let more = stepped(&mut *training, &data, 40);
    let end = parameters(&*training);
    for name in start.keys().filter(of_network) {
        assert_ne!(start[name], end[name], "{name}");
    }
    assert_ne!(means(&*training, 0.0), means(&*training, 1.0));
    let mean = |losses: &[f64]| losses.iter().sum::<f64>() / losses.len() as f64;
    assert!(mean(&more[34..]) < mean(&losses[..6]), "{losses:?} {more:?}");
    assert_eq!(training.model().counts().primitives, 260, "added up to the budget");
}

#[test]
fn a_resumed_training_has_the_bits_of_one_that_was_not_stopped() {
    // with additions to come, and between two
    for stop in [22, 23] {
        check_checkpoint(&config(&["d3dgs.time_noise=0.4"]), &data(), stop, 20);
    }
}

#[test]
fn one_image_is_learnt_by_heart_and_the_file_draws_it() {
    let root = tempfile::tempdir().unwrap();
    write_sphere_dataset(root.path(), 6, 16).unwrap();
    let more = [
        "data.times=1",
        "data.views_per_time=1",
        "stages.warmup_steps=100",
        "stages.joint_steps=200",
        "loss.dssim=0",
        "optim.sh=0.02",
        "densify.mode=off",
        "densify.budget=200",
    ];
    let config = config(&more);
    let data = open_dataset(root.path(), &config).unwrap();
    let mut training = crate::start(&config, &data, &device()).unwrap();
    let psnr = (0..300).map(|_| training.step(&data.train).unwrap().psnr).last().unwrap();
    assert!(psnr > 30.0, "{psnr} dB");
    let path = root.path().join("scene.safetensors");
    training.model().save(&path).unwrap();
    let read = crate::named_in(&config).unwrap().open(&path, &device()).unwrap();
    let camera = data.train.frames[0].camera.to_kernel();
    assert_eq!(read.render(camera, 0.3), training.model().render(camera, 0.3));
    let scene: Scene = read.into_scene().unwrap();
    assert!(scene.spec.d3dgs.is_some() && !scene.opacity_changes());
    // a header that asks for memory no D3DGS scene needs
    let mut damaged = scene.clone();
    damaged.spec.model.embedding = usize::MAX / 8;
    damaged.save(&path).unwrap();
    let error = Scene::load(&path, &device()).unwrap_err().to_string();
    assert!(error.contains("D3DGS has no model.embedding"), "{error}");
    let some = scene.subset(&[3, 50]).deformed(0.3);
    assert_eq!(some.means, scene.host_at(0.3).subset(&[3, 50]).means);
}

#[test]
fn settings_of_another_method_are_refused() {
    let error = |config: &Config| crate::check(config).unwrap_err().to_string();
    let mut ours = config(&[]);
    ours.method = "volseggs".into();
    assert!(error(&ours).contains("[d3dgs]: belongs to the method d3dgs"), "{}", error(&ours));
    let none = Config { method: "d3dgs".into(), ..Config::default() };
    assert!(error(&none).contains("section [d3dgs]"), "{}", error(&none));
    for (key, words) in
        [("d3dgs.skip=4", "d3dgs.skip = 4: below"), ("d3dgs.octaves=25", "d3dgs.octaves = 25: from 0 to 24")]
    {
        assert!(error(&config(&[key])).contains(words), "{}", error(&config(&[key])));
    }
    for key in [
        "speed.cull_visits=4",
        "model.embedding=4",
        "model.encoder=implicit",
        "loss.tv=0.1",
        "loss.tv_time=0.1",
        "loss.one_prior=0.1",
        "d3dgs.time_noise_steps=0",
    ] {
        let name = key.split('=').next().unwrap();
        assert!(error(&config(&[key])).contains(name), "{}", error(&config(&[key])));
    }
    crate::check(&config(&[])).unwrap();
}
