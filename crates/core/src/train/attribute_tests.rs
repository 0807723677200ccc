//! Tests of training with the optional attributes, normals and embeddings: what is trained, what a checkpoint keeps,
//! and what new Gaussians receive.

use super::Trainer;
use super::checkpoint::{self, CheckpointState};
use crate::config::preset;
use crate::config::types::{Appearance, Config, ShBands, TimeCurve};
use crate::data::Dataset;
use crate::data::dataset::OpenOptions;
use crate::data::fixture::write_sphere_dataset;
use crate::device::DeviceName;
use crate::model::embedding::HostEmbedding;
use crate::model::fixture::spec;
use crate::model::{HostGaussians, Rendering, Scene, ToKernel, params};
use burn::tensor::Device;
use volseggs_kernels::shading::Light;

fn config(appearance: Appearance) -> Config {
    let mut config = preset("best").unwrap();
    (config.init.points, config.model.appearance) = (200, appearance);
    (config.model.sh_bands, config.model.sh_degree) = (ShBands::All, 1);
    (config.model.resolution, config.model.channels, config.model.width) = (8, 8, 16);
    (config.stages.warmup_steps, config.stages.joint_steps) = (4, 20);
    (config.densify.every, config.densify.warmup_from, config.densify.joint_from) = (3, 0, 0);
    (config.densify.joint_until, config.densify.budget, config.speed.sort_every) = (20, 260, 5);
    // one loss from the first step to the last
    config.loss.dssim = 0.0;
    config
}

fn data() -> Dataset {
    let folder = tempfile::tempdir().unwrap();
    write_sphere_dataset(folder.path(), 6, 16).unwrap();
    Dataset::open(folder.path(), &OpenOptions::default()).unwrap()
}

fn device() -> Device {
    DeviceName::all()[0].open().unwrap()
}

fn stepped(trainer: &mut Trainer, data: &Dataset, steps: usize) -> Vec<f64> {
    (0..steps).map(|_| trainer.step(&data.train).unwrap().loss).collect()
}

#[test]
fn normals_and_material_are_trained_and_follow_the_gaussians() {
    let (config, data) = (config(Appearance::Headlight), data());
    let mut trainer = Trainer::new(config.clone(), &data, &device()).unwrap();
    let first = trainer.scene().gaussians.to_host().shading.unwrap();
    assert!(first.normals.chunks_exact(3).all(|n| (n.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5));
    let losses = stepped(&mut trainer, &data, 24);
    assert!(losses.iter().all(|loss| loss.is_finite()) && losses[23] < losses[0], "{losses:?}");
    let host = trainer.scene().gaussians.to_host();
    assert_eq!((host.len(), host.mismatched_column()), (260, None), "it densified to its budget");
    let shading = host.shading.unwrap();
    assert_ne!(shading.material, first.material);
    assert_ne!(shading.normals[..first.normals.len()], first.normals[..]);
}

/// A configuration with both attributes and space-time planes.
fn embedded() -> Config {
    let mut config = config(Appearance::Headlight);
    (config.model.encoder, config.model.time_curve) = ("hexplane".into(), TimeCurve::Cubic);
    (config.model.embedding, config.optim.embedding) = (5, 0.01);
    config
}

#[test]
fn embeddings_start_at_zero_are_trained_in_the_joint_stage_and_follow_the_gaussians() {
    let data = data();
    let mut trainer = Trainer::new(embedded(), &data, &device()).unwrap();
    let values = |trainer: &Trainer| trainer.scene().gaussians.to_host().embedding.unwrap().values;
    assert_eq!(values(&trainer), vec![0.0; 5 * 200]);
    let before = stepped(&mut trainer, &data, 4);
    assert!(values(&trainer).iter().all(|v| *v == 0.0), "warm-up has no field");
    let losses = stepped(&mut trainer, &data, 20);
    assert!(losses.iter().all(|loss| loss.is_finite()) && losses[19] < before[0], "{losses:?}");
    let host = trainer.scene().gaussians.to_host();
    assert_eq!((host.len(), host.mismatched_column()), (260, None), "it densified to its budget");
    let nonzero = values(&trainer).chunks_exact(5).filter(|e| e.iter().any(|v| *v != 0.0)).count();
    assert!(nonzero > 200, "{nonzero} of 260");
}

#[test]
fn gaussians_at_one_place_move_apart_by_their_embeddings() {
    let mut model = embedded().model;
    model.appearance = Appearance::Sh;
    let spec = spec(model);
    let mut two = HostGaussians::zeros(2, 4);
    two.rotations = [1.0, 0.0, 0.0, 0.0].repeat(2);
    let at = |values: Vec<f32>| {
        let embedding = Some(HostEmbedding { width: 5, values });
        let scene = Scene::new(HostGaussians { embedding, ..two.clone() }, spec.clone(), 1, &device());
        let all = scene.host_at(0.7);
        assert_eq!((all.embedding.as_ref(), scene.subset(&[1]).deformed(0.7).means), (None, all.subset(&[1]).means));
        all.means
    };
    let same = at(vec![0.5; 10]);
    assert_eq!(same[..3], same[3..]);
    let apart = at([vec![0.5; 5], vec![-0.5; 5]].concat());
    assert_eq!(apart[..3], same[..3]);
    assert_ne!(apart[3..], same[3..]);
}

#[test]
fn a_resumed_run_has_the_bits_of_one_that_was_not_stopped() {
    let (config, data, folder) = (embedded(), data(), tempfile::tempdir().unwrap());
    let text = toml::to_string(&config).unwrap();
    let mut whole = Trainer::new(config.clone(), &data, &device()).unwrap();
    stepped(&mut whole, &data, 11);
    let (step, initial, dataset) = (11, whole.initial, data.fingerprint());
    let state =
        CheckpointState { step, initial, dataset: dataset.clone(), config: text.clone(), seconds: 0.0, packed: false };
    let path = checkpoint::save(folder.path(), &whole, &state, 1).unwrap();
    stepped(&mut whole, &data, 13);
    let mut resumed = Trainer::new(config, &data, &device()).unwrap();
    checkpoint::restore(&path, &mut resumed, &text, &dataset).unwrap();
    stepped(&mut resumed, &data, 13);
    assert_eq!(params::collect(resumed.scene()), params::collect(whole.scene()));
}

#[test]
fn a_shaded_scene_is_drawn_from_its_file_as_it_was_trained() {
    let (data, folder) = (data(), tempfile::tempdir().unwrap());
    let mut trainer = Trainer::new(embedded(), &data, &device()).unwrap();
    stepped(&mut trainer, &data, 8);
    let path = folder.path().join("scene.safetensors");
    trainer.scene().save(&path).unwrap();
    let read = Scene::load(&path, &device()).unwrap();
    let camera = data.train.frames[1].camera.to_kernel();
    let picture = read.render(camera, 0.4);
    assert_eq!(picture, trainer.scene().render(camera, 0.4));
    // the Gaussians of a time read back to the host are drawn alike, and their light affects the picture
    let host = read.host_at(0.4);
    let draw = |g: &HostGaussians, degree: usize| {
        let rendering = Rendering { sh_degree: degree, ..read.spec.rendering() };
        crate::model::pictures::draw(g, rendering.seen_by(camera), &device())
    };
    assert_eq!(draw(&host, read.spec.sh_degree), picture);
    let unlit = HostGaussians { shading: None, ..host.clone() };
    assert_ne!(draw(&unlit, read.spec.sh_degree), picture);
    let mut moved = host.clone();
    moved.shading.as_mut().unwrap().light = Light::Far([0.0, 0.0, 1.0]);
    assert_ne!(draw(&moved, read.spec.sh_degree), picture);
    // spherical harmonics alone come close
    let baked = draw(&host.baked(), 2);
    let off = baked.iter().zip(&picture).map(|(a, b)| (a - b).abs()).sum::<f32>() / picture.len() as f32;
    assert!(off < 0.02, "{off}");
}

#[test]
fn harmonics_alone_have_no_parameter_of_shading() {
    let data = data();
    let names = |appearance: Appearance| -> Vec<String> {
        let trainer = Trainer::new(config(appearance), &data, &device()).unwrap();
        params::collect(trainer.scene()).into_keys().collect()
    };
    let (plain, shaded) = (names(Appearance::Sh), names(Appearance::Headlight));
    let more: Vec<&String> = shaded.iter().filter(|name| !plain.contains(name)).collect();
    assert_eq!(more, ["gaussians.headlight.material", "gaussians.headlight.normals"]);
    assert_eq!(shaded.len(), plain.len() + 2);
}

#[test]
fn even_bands_are_trained_one_after_the_other_and_drawn_from_their_file_alike() {
    let (mut config, data, folder) = (config(Appearance::Sh), data(), tempfile::tempdir().unwrap());
    (config.model.sh_bands, config.model.sh_degree, config.stages.sh_every) = (ShBands::Even, 4, 5);
    let mut trainer = Trainer::new(config, &data, &device()).unwrap();
    let mut degrees = Vec::new();
    for _ in 0..24 {
        assert!(trainer.step(&data.train).unwrap().loss.is_finite());
        degrees.push(trainer.scene().spec.sh_degree);
    }
    degrees.dedup();
    assert_eq!(degrees, [0, 2, 4]);
    let path = folder.path().join("scene.safetensors");
    trainer.scene().save(&path).unwrap();
    let read = Scene::load(&path, &device()).unwrap();
    let host = read.gaussians.to_host();
    assert_eq!((host.len(), host.sh_stride, host.sh_degree(), host.mismatched_column()), (260, 15, 4, None));
    assert!(host.sh.chunks_exact(45).any(|sh| sh[18..].iter().all(|v| *v != 0.0)), "band 4 is trained");
    let camera = data.train.frames[1].camera.to_kernel();
    let picture = read.render(camera, 0.4);
    assert_eq!(picture, trainer.scene().render(camera, 0.4));
    // without band 4, as other programs draw it
    let rendering = Rendering { sh_degree: 2, ..read.spec.rendering() };
    let draw = |g: &HostGaussians| crate::model::pictures::draw(g, rendering.seen_by(camera), &device());
    let (baked, upto_2) = (draw(&read.host_at(0.4).baked()), draw(&read.host_at(0.4)));
    assert!(baked.iter().zip(&upto_2).all(|(a, b)| (a - b).abs() < 1e-5));
    assert_ne!(upto_2, picture);
}
