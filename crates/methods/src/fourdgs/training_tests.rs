//! Training of 4D Gaussians: it learns, gives the same result however it is run, and damaged files are refused.

use super::model::Scene4d;
use super::rotation_matrices;
use super::rows::apply;
use crate::test_support::{ball, changed, check_checkpoint, device, parameters, stepped};
use burn::tensor::{Tensor, TensorData};
use std::collections::BTreeMap;
use volseggs_base::rng::{Purpose, Rng};
use volseggs_core::config::types::Config;
use volseggs_core::model::params::{HostTensor, to_vec};
use volseggs_core::model::scene_file::{read_tensors, write_tensors};
use volseggs_core::model::{Model, ToKernel};
use volseggs_core::train::densify::RowSource;
use volseggs_core::train::open_dataset;
use volseggs_volume::data::Dataset;
use volseggs_volume::data::fixture::write_sphere_dataset;

/// The small preset with few steps and few Gaussians, and with everything switched on.
fn config(more: &[&str]) -> Config {
    let few = [
        "init.points=200",
        "stages.warmup_steps=60",
        "stages.sh_every=5",
        "densify.budget=260",
        "densify.every=5",
        "densify.warmup_from=0",
        "densify.warmup_until=40",
        "densify.prune_every=5",
        "4dgs.rigid_every=7",
        "4dgs.time_threshold=1e-5",
        "speed.sort_every=11",
    ];
    changed("4dgs-small", &few, more)
}

fn data() -> Dataset {
    ball(6, 16)
}

#[test]
fn every_parameter_is_trained_and_gaussians_are_added_up_to_the_budget() {
    let (config, data) = (config(&["densify.mode=budget"]), data());
    let mut training = crate::start(&config, &data, &device()).unwrap();
    let start = parameters(&*training);
    let names: Vec<&str> = start.keys().map(|name| name.strip_prefix("gaussians.").unwrap()).collect();
    assert_eq!(names, ["left", "log_scales", "means", "opacity_logits", "right", "sh", "times"]);
    assert_eq!(start["gaussians.sh"].shape, [200, 3 * 4, 3], "three orders of degree 1");
    let times = &start["gaussians.times"].values;
    assert!(times.iter().all(|t| (-0.1..=1.1).contains(t)) && times.iter().any(|t| *t < 0.0));
    let losses = stepped(&mut *training, &data, 60);
    let end = parameters(&*training);
    assert_eq!(training.model().counts().primitives, 260);
    assert_eq!(training.model().counts().parameters, 260 * 53);
    assert_eq!(end["gaussians.sh"].shape, [260, 3 * 4, 3]);
    // after sorting and splitting no row is in its place, so the magnitude of each column is compared
    for (name, tensor) in &end {
        let spread = |t: &HostTensor| t.values.iter().map(|v| f64::from(v.abs())).sum::<f64>() / t.values.len() as f64;
        assert!((spread(tensor) - spread(&start[name])).abs() > 1e-6, "{name} was not trained");
    }
    // colours of every order in time
    let last = end["gaussians.sh"].values.chunks_exact(36).map(|row| row[24].abs()).fold(0.0, f32::max);
    assert!(last > 0.0, "the last order has no colours");
    let mean = |losses: &[f64]| losses.iter().sum::<f64>() / losses.len() as f64;
    assert!(mean(&losses[50..]) < mean(&losses[..10]), "{losses:?}");
    let camera = data.train.frames[0].camera.to_kernel();
    let at = |time: f32| training.model().render(camera, time);
    assert_ne!(at(0.0), at(1.0), "time matters");
}

#[test]
fn a_resumed_training_has_the_bits_of_one_that_was_not_stopped() {
    // with additions and a reset to come, with a sort to come, and between two of each and two neighbour searches
    for stop in [15, 22, 23] {
        check_checkpoint(&config(&["densify.opacity_reset=15"]), &data(), stop, 30);
    }
}

#[test]
fn the_number_of_threads_does_not_change_a_bit() {
    let (config, data) = (config(&[]), data());
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut training = crate::start(&config, &data, &device()).unwrap();
            (stepped(&mut *training, &data, 25), parameters(&*training))
        })
    };
    let one = run(1);
    assert!(one == run(4), "the number of threads changed the result");
}

#[test]
fn one_image_is_learnt_by_heart_and_the_file_draws_it() {
    let root = tempfile::tempdir().unwrap();
    write_sphere_dataset(root.path(), 6, 16).unwrap();
    let more = [
        "data.times=1",
        "data.views_per_time=1",
        "stages.warmup_steps=300",
        "loss.dssim=0",
        "optim.sh=0.02",
        "densify.mode=off",
        "densify.budget=200",
        "densify.prune_opacity=0",
        "densify.opacity_reset=0",
        "densify.opacity_reset_until=0",
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
    assert_eq!((read.counts(), read.background()), (training.model().counts(), training.model().background()));
    assert_eq!(read.place(), training.model().place());
    assert!(read.scene().is_none() && read.into_scene().is_none());
}

#[test]
fn halves_are_drawn_from_their_parent_in_space_and_time() {
    let device = device();
    let tensor = |shape: &[usize], values: &[f32]| HostTensor { shape: shape.to_vec(), values: values.to_vec() };
    let (left, right) = ([0.9, 0.2, -0.3, 0.5], [0.3, -0.8, 0.4, 0.6]);
    let old = BTreeMap::from([
        ("gaussians.means".to_owned(), tensor(&[1, 3], &[1.0, 2.0, 3.0])),
        ("gaussians.times".to_owned(), tensor(&[1], &[0.5])),
        ("gaussians.log_scales".to_owned(), tensor(&[1, 4], &[-1.0, -2.0, -3.0, -1.5])),
        ("gaussians.left".to_owned(), tensor(&[1, 4], &left)),
        ("gaussians.right".to_owned(), tensor(&[1, 4], &right)),
    ]);
    const N: usize = 20_000;
    let rows: Vec<RowSource> =
        [RowSource::Keep(0), RowSource::Clone(0)].into_iter().chain((0..N).map(|_| RowSource::Half(0))).collect();
    let new = apply(&rows, &old, Rng::new(1, 2, Purpose::Split), &device);
    for j in 0..2 {
        assert_eq!(new["gaussians.means"].values[3 * j..][..3], [1.0, 2.0, 3.0]);
        assert_eq!(new["gaussians.log_scales"].values[4 * j..][..4], [-1.0, -2.0, -3.0, -1.5]);
    }
    let smaller = |s: f32| s - 1.6f32.ln();
    assert_eq!(new["gaussians.log_scales"].values[8..12], [-1.0f32, -2.0, -3.0, -1.5].map(smaller));
    assert_eq!(new["gaussians.times"].shape, [N + 2]);
    // their covariance is the parent's, R S S R^T
    let place = |j: usize| -> [f64; 4] {
        let (m, t) = (&new["gaussians.means"].values[3 * j..][..3], new["gaussians.times"].values[j]);
        [m[0] - 1.0, m[1] - 2.0, m[2] - 3.0, t - 0.5].map(f64::from)
    };
    let rows = |q: [f32; 4]| Tensor::<2>::from_data(TensorData::new(q.to_vec(), [1, 4]), &device);
    let r = to_vec(rotation_matrices(rows(left), rows(right)));
    for (a, b) in [(0, 0), (1, 1), (2, 2), (3, 3), (0, 3), (1, 2), (2, 3)] {
        let exact: f64 = (0..4)
            .map(|k| f64::from(r[4 * a + k] * r[4 * b + k]) * f64::from([-1.0f32, -2.0, -3.0, -1.5][k]).exp().powi(2))
            .sum();
        let found = (2..N + 2).map(|j| place(j)[a] * place(j)[b]).sum::<f64>() / N as f64;
        assert!((found - exact).abs() < 0.004, "{a}, {b}: {found} {exact}");
    }
}

#[test]
fn damaged_files_are_refused_and_named() {
    let (config, data, folder) = (config(&[]), data(), tempfile::tempdir().unwrap());
    let training = crate::start(&config, &data, &device()).unwrap();
    let path = folder.path().join("scene.safetensors");
    training.model().save(&path).unwrap();
    let (good, metadata) = read_tensors(&path).unwrap();
    let header = metadata["4dgs"].clone();
    let refused = |tensors: &BTreeMap<String, HostTensor>, header: Option<String>| -> String {
        write_tensors(&path, tensors, header.map(|h| ("4dgs", h))).unwrap();
        Scene4d::read(&path, &device()).unwrap_err().to_string()
    };
    let check = |text: &str, words: &str| assert!(text.contains(words) && text.contains("scene.safetensors"), "{text}");
    check(&refused(&good, None), "another method");
    for (from, to, words) in [
        ("\"sh_stride\":4", "\"sh_stride\":5", "orders of 5"),
        ("\"orders\":3", "\"orders\":4000000000", "orders of 4"),
        ("\"orders\":3", "\"orders\":2", "gaussians.sh"),
        ("\"sh_degree\":0", "\"sh_degree\":2", "do not fit"),
        ("\"time_degree\":0", "\"time_degree\":3", "do not fit"),
    ] {
        assert!(header.contains(from), "{header}");
        check(&refused(&good, Some(header.replace(from, to))), words);
    }
    let changed = |name: &str, change: fn(&mut HostTensor)| {
        let mut tensors = good.clone();
        change(tensors.get_mut(name).unwrap());
        refused(&tensors, Some(header.clone()))
    };
    check(&changed("gaussians.times", |t| t.values[7] = f32::NAN), "gaussians.times, row 7");
    let short = |t: &mut HostTensor| (t.shape, t.values) = (vec![3], vec![0.0; 3]);
    check(&changed("gaussians.times", short), "differ in length");
    let mut none = good.clone();
    none.values_mut().for_each(|t| (t.shape[0], t.values) = (0, Vec::new()));
    check(&refused(&none, Some(header.clone())), "no Gaussian");
    let mut less = good.clone();
    less.remove("gaussians.right");
    check(&refused(&less, Some(header.clone())), "gaussians.right");
    write_tensors(&path, &good, Some(("4dgs", header.clone()))).unwrap();
    assert_eq!(Scene4d::read(&path, &device()).unwrap().parameters(), good);
}

#[test]
fn settings_without_effect_are_refused() {
    let error = |config: &Config| crate::check(config).unwrap_err().to_string();
    crate::check(&config(&[])).unwrap();
    for (key, words) in [
        ("stages.joint_steps=5", "stages.joint_steps = 5"),
        ("stages.warmup_times=middle", "stages.warmup_times"),
        ("model.appearance=headlight", "model.appearance"),
        ("model.encoder=implicit", "model.encoder"),
        ("model.deform_opacity=false", "model.deform_opacity = false"),
        ("loss.tv=0.1", "loss.tv = 0.1"),
        ("loss.tv_time=0.1", "loss.tv_time = 0.1"),
        ("loss.one_prior=0.1", "loss.one_prior = 0.1"),
        ("speed.coarse_steps=5", "speed.coarse_steps = 5"),
        ("speed.cull_visits=4", "speed.cull_visits = 4"),
        ("densify.threshold=0", "4dgs.time_threshold"),
        ("4dgs.time_orders=9", "4dgs.time_orders = 9"),
    ] {
        assert!(error(&config(&[key])).contains(words), "{}", error(&config(&[key])));
    }
    let huge = crate::start(&config(&["init.points=2000000000"]), &data(), &device());
    let huge = huge.err().map(|e| e.to_string()).unwrap_or_default();
    assert!(huge.contains("init.points = 2000000000") && huge.contains("needs about"), "{huge}");
    let mut ours = config(&[]);
    ours.method = "volseggs".into();
    assert!(error(&ours).contains("[4dgs]: belongs to the method 4dgs"), "{}", error(&ours));
    let none = Config { method: "4dgs".into(), ..Config::default() };
    assert!(error(&none).contains("section [4dgs]"), "{}", error(&none));
}
