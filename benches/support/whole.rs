//! The whole training step, as `Trainer::step` reports it, on a dataset of two views.

use crate::common::{self, Samples, Scene, Splatter};
use crate::counting;
use crate::{DISTANCE, SIZE, Stage};
use burn::tensor::Device;
use glam::DVec3;
use std::path::Path;
use std::time::Instant;
use volseggs::config::types::{Bounds, Config, Placement};
use volseggs::data::{Camera, Dataset, OpenOptions};
use volseggs::method::preset;
use volseggs::model::ToKernel;
use volseggs::model::params::to_vec;
use volseggs::train::Trainer;

/// Writes two views of a ball of Gaussians as a dataset folder.
fn write_dataset(folder: &Path) {
    let scene = common::scene(20_000, 13);
    let mut frames = Vec::new();
    for (i, eye) in [DVec3::new(2.8, 2.4, 1.5), DVec3::new(-2.4, 2.8, 1.5)].into_iter().enumerate() {
        let (size, eye) = (SIZE as u32, DISTANCE * eye.normalize());
        let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 30f64.to_radians(), size, size);
        let image = common::image(&Splatter::new(&scene, camera.to_kernel(), &Device::flex()).forward());
        let byte = |v: f32| (255.0 * v.clamp(0.0, 1.0)).round() as u8;
        let straight = |p: &[f32]| [0, 1, 2, 3].map(|c| byte(if c < 3 { p[c] / p[3].max(1e-6) } else { p[3] }));
        let bytes: Vec<u8> = image.chunks_exact(4).flat_map(straight).collect();
        image::save_buffer(folder.join(format!("r_{i}.png")), &bytes, size, size, image::ColorType::Rgba8).unwrap();
        let rows: Vec<_> = (0..4).map(|row| camera.camera_to_world.row(row).to_array()).collect();
        frames.push(serde_json::json!({ "file_path": format!("./r_{i}"), "time": i as f64, "transform_matrix": rows }));
    }
    let json = serde_json::json!({ "camera_angle_x": 30f64.to_radians(), "frames": frames });
    std::fs::write(folder.join("transforms_train.json"), json.to_string()).unwrap();
}

/// Measures joint steps with DSSIM and without densification, starting from the trainer's own Gaussians.
pub fn whole_step(n: usize, repeats: usize, device: &Device) -> Vec<Stage> {
    let folder = tempfile::tempdir().unwrap();
    write_dataset(folder.path());
    let dataset = Dataset::open(folder.path(), &OpenOptions::default()).unwrap();
    let mut config = preset("best").unwrap();
    // a cube with the volume of the unit ball
    (config.init.points, config.init.placement, config.init.box_half_size) = (n, Placement::Box, 0.806);
    (config.init.scale, config.init.opacity, config.model.bounds) = (0.7, 0.3, Bounds::Points);
    (config.stages.warmup_steps, config.stages.joint_steps, config.stages.sh_every) = (0, 1_000_000, 0);
    config.loss.dssim_last = config.stages.joint_steps;
    (config.densify.mode, config.densify.budget, config.densify.prune_opacity) = ("off".into(), n, 0.0);
    let trainer = Trainer::new(config, &dataset, device).unwrap();
    measure_steps(trainer, &dataset, repeats)
}

/// Returns the Gaussians of a trained scene at time 0.5, and the normalised points at which its field is read.
pub fn trained_scene(path: &Path) -> (Scene, Vec<f32>) {
    let scene = volseggs::model::Scene::load(path, &Device::flex()).unwrap();
    let canonical = scene.gaussians.to_host();
    let spec = &scene.spec;
    let place = |(i, m): (usize, &f32)| (m - spec.centre[i % 3]) / spec.half_size[i % 3];
    let points = canonical.means.iter().enumerate().map(place).collect();
    let at = scene.deformed(0.5);
    let host = Scene {
        means: to_vec(at.means),
        rotations: to_vec(at.rotations),
        log_scales: to_vec(at.log_scales),
        opacity_logits: to_vec(at.opacity_logits),
        sh: canonical.sh,
    };
    (host, points)
}

/// Measures joint steps with DSSIM and without densification from a trained scene, each step on its own view.
pub fn trained_step(scene: &Path, data: &Path, repeats: usize, device: &Device) -> Vec<Stage> {
    let dataset = Dataset::open(data, &OpenOptions::default()).unwrap();
    let scene = volseggs::model::Scene::load(scene, &device.clone().autodiff()).unwrap();
    let mut config = Config { model: scene.spec.model.clone(), ..preset("best").unwrap() };
    (config.stages.warmup_steps, config.stages.joint_steps, config.stages.sh_every) = (0, 1_000_000, 0);
    config.loss.dssim_last = config.stages.joint_steps;
    config.init.points = scene.gaussians.count();
    (config.densify.mode, config.densify.budget, config.densify.prune_opacity) =
        ("off".into(), config.init.points, 0.0);
    let trainer = Trainer::from_scene(config, scene, &dataset).unwrap();
    measure_steps(trainer, &dataset, repeats)
}

/// Measures frames of a trained scene without gradients, up to the image on the host: with the deformation recomputed
/// for each frame, and with the time held fixed.
pub fn frames(path: &Path, repeats: usize, device: &Device) -> Vec<Stage> {
    let scene = volseggs::model::Scene::load(path, device).unwrap();
    let (camera, background) = (common::camera(SIZE), scene.spec.background);
    let held = scene.deformed(0.5);
    let mut frame = 0;
    let moving = common::measure(repeats, || {
        frame += 1;
        scene.render(camera, frame as f32 / repeats as f32)
    });
    let still = common::measure(repeats, || to_vec(scene.draw(held.clone(), camera, background, None).image));
    vec![("frame, time moving", moving.0), ("frame, time held", still.0)]
}

fn measure_steps(mut trainer: Trainer, dataset: &Dataset, repeats: usize) -> Vec<Stage> {
    let names = ["data", "deform", "splat", "loss", "backward", "adam", "statistics", "**whole step**"];
    let mut samples = names.map(|_| Vec::new());
    let device = trainer.device().clone();
    let mut from = Instant::now();
    for run in 0..=repeats {
        let (start, before) = (Instant::now(), counting::count());
        let t = trainer.step(&dataset.train).unwrap().times;
        let parts = [t.data, t.deform, t.splat, t.loss, t.backward, t.adam, t.densify, start.elapsed()];
        if run == 0 {
            device.sync().unwrap();
            from = Instant::now();
        } else {
            samples.iter_mut().zip(parts).for_each(|(s, part)| s.push(part.as_secs_f64() * 1e3));
        }
        if run == repeats {
            println!("\nallocations of the last step: {}", counting::count() - before);
        }
    }
    device.sync().unwrap();
    // a device that works asynchronously shows its time only here; the parts above are then host time
    let mean = from.elapsed().as_secs_f64() * 1e3 / repeats as f64;
    let mut out: Vec<Stage> = names.into_iter().zip(samples.map(Samples::new)).collect();
    out.push(("mean of all steps, device finished", Samples::new(vec![mean])));
    out
}
