//! Shared parts of the whole-program tests: a small dataset that is rendered here, small settings, the binary.
#![allow(dead_code, clippy::unwrap_used)] // each test file uses a part of it

use assert_cmd::Command;
use glam::DVec3;
use image::{Rgba, RgbaImage};
use serde_json::Value;
use std::path::{Path, PathBuf};
use tempfile::TempDir;
use volseggs::data::paths::{FOV_X, Lens, RADIUS, deal_times, test_spiral, training_cameras};
use volseggs::data::transforms::{FrameRecord, Intrinsics};
use volseggs::data::{Camera, SplitName, Transforms};
use volseggs::device::DeviceName;
use volseggs::train::checkpoint;

/// Width and height of the images in pixels.
pub const SIZE: u32 = 32;
/// Number of times in the dataset.
pub const TIMES: usize = 4;
/// Training views per time.
pub const VIEWS: usize = 6;

/// The program under test.
pub const BINARY: &str = env!("CARGO_BIN_EXE_volseggs");

/// A run of 80 steps that densifies from 300 to exactly 400 Gaussians.
pub const SETTINGS: &[&str] = &[
    "init.points=300",
    "model.sh_degree=2",
    "model.resolution=8",
    "model.time_knots=5",
    "model.channels=8",
    "model.width=16",
    "stages.warmup_steps=20",
    "stages.joint_steps=60",
    "stages.sh_every=10",
    "loss.dssim_last=20",
    "densify.budget=400",
    "densify.every=5",
    "densify.warmup_from=5",
    "densify.joint_from=5",
    "densify.joint_until=40",
    "densify.prune_every=10",
    "output.log_every=10",
    "output.eval_every=40",
    "output.eval_views=2",
    "output.checkpoint_every=10",
];

/// Three coloured translucent balls at a time: centre, radius, colour.
fn balls(time: f64) -> [(DVec3, f64, [f64; 3]); 3] {
    let turn = std::f64::consts::PI * time;
    [
        (0.55 * DVec3::new(turn.cos(), turn.sin(), 0.0), 0.3, [0.9, 0.2, 0.1]),
        (DVec3::new(0.0, -0.2, 0.8 * time - 0.4), 0.25, [0.1, 0.7, 0.3]),
        (DVec3::new(-0.3, 0.3, 0.3), 0.2 + 0.15 * time, [0.2, 0.3, 0.9]),
    ]
}

/// Renders the balls for a camera, with straight alpha: light falls off along the path through each ball, and the balls
/// are blended from front to back.
fn picture(camera: &Camera, time: f64) -> RgbaImage {
    let (rotation, _) = camera.world_to_camera_opencv();
    let eye = camera.position();
    RgbaImage::from_fn(camera.width, camera.height, |x, y| {
        let local =
            DVec3::new((f64::from(x) + 0.5 - camera.cx) / camera.fx, (f64::from(y) + 0.5 - camera.cy) / camera.fy, 1.0);
        let ray = rotation.transpose() * local.normalize();
        let mut hits: Vec<(f64, f64, [f64; 3])> = Vec::new();
        for (centre, radius, colour) in balls(time) {
            let along = (centre - eye).dot(ray);
            let off = (eye + along * ray - centre).length_squared();
            if off < radius * radius {
                let way = 2.0 * (radius * radius - off).sqrt();
                hits.push((along, 1.0 - (-5.0 * way).exp(), colour));
            }
        }
        hits.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (mut sum, mut through) = ([0.0; 3], 1.0);
        for (_, alpha, colour) in hits {
            (0..3).for_each(|c| sum[c] += through * alpha * colour[c]);
            through *= 1.0 - alpha;
        }
        let alpha = 1.0 - through;
        let byte = |v: f64| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
        let [r, g, b] = sum.map(|v| byte(if alpha > 0.0 { v / alpha } else { 0.0 }));
        Rgba([r, g, b, byte(alpha)])
    })
}

fn write_split(root: &Path, name: SplitName, views: &[(Camera, f64)]) {
    std::fs::create_dir_all(root.join(name.as_str())).unwrap();
    let frames = views.iter().enumerate().map(|(i, (camera, time))| {
        let file_path = format!("./{name}/r_{i:03}");
        picture(camera, *time).save(root.join(format!("{name}/r_{i:03}.png"))).unwrap();
        FrameRecord { file_path, camera_to_world: camera.camera_to_world, time: *time }
    });
    let intrinsics = Intrinsics { camera_angle_x: Some(FOV_X), ..Intrinsics::default() };
    let json = Transforms { path: name.json_path(root), intrinsics, frames: frames.collect() };
    json.write(&json.path).unwrap();
}

/// Writes the dataset into `root`: 24 training views at 4 times, 6 test views.
pub fn write_dataset(root: &Path) {
    let lens = Lens { fov_x: FOV_X, width: SIZE, height: SIZE };
    let cameras = training_cameras(TIMES * VIEWS, RADIUS, lens);
    let times = deal_times(TIMES, VIEWS, 1).into_iter().map(|t| t as f64 / (TIMES - 1) as f64);
    let train: Vec<(Camera, f64)> = cameras.into_iter().zip(times).collect();
    write_split(root, SplitName::Train, &train);
    write_split(root, SplitName::Test, &test_spiral(6, TIMES, RADIUS, lens));
}

/// A temporary folder with the dataset in `data`.
pub fn dataset() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_dataset(&folder.path().join("data"));
    folder
}

/// Arguments of a small training run: dataset in `root/data`, results in `root/NAME`, then `more` settings.
pub fn train_arguments(root: &Path, name: &str, more: &[&str]) -> Vec<String> {
    let path = |p: &str| root.join(p).display().to_string();
    let mut arguments = vec!["train".into(), "--data".into(), path("data"), "--out".into(), path(name)];
    for setting in SETTINGS.iter().chain(more) {
        arguments.extend(["--set".to_owned(), (*setting).to_owned()]);
    }
    arguments
}

/// The program, without settings from the environment and with a time limit.
pub fn volseggs() -> Command {
    let mut command = Command::new(BINARY);
    command.timeout(std::time::Duration::from_secs(300));
    for (name, _) in std::env::vars_os() {
        if name.to_string_lossy().starts_with("VOLSEGGS_") {
            command.env_remove(name);
        }
    }
    command
}

/// Runs the program in `root` with `--json` and returns what it prints.
pub fn run_json(root: &Path, arguments: &[&str]) -> Value {
    let output = volseggs().current_dir(root).args(arguments).arg("--json").assert().success().get_output().clone();
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Makes a new folder `name` beside the build, with the dataset in `data` and in `run` a small run with coarse
/// segments, found with `more` arguments. For tests that share one run and copy it before they write into it.
pub fn with_segments(name: &str, more: &[&str]) -> PathBuf {
    let root = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    if root.exists() {
        std::fs::remove_dir_all(&root).unwrap();
    }
    write_dataset(&root.join("data"));
    train(&root, "run", &[]).assert().success();
    volseggs().current_dir(&root).args(["segment", "coarse", "run"]).args(more).assert().success();
    root
}

/// Copies a folder with all its contents.
pub fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for name in names(from) {
        let (from, to) = (from.join(&name), to.join(&name));
        if from.is_dir() {
            copy(&from, &to);
        } else {
            std::fs::copy(&from, &to).unwrap();
        }
    }
}

/// A device that is compiled in, for `volseggs_testing::on_every_device`; `None` if it does not start, which has then
/// been reported.
pub fn open(name: &str) -> Option<DeviceName> {
    let device: DeviceName = name.parse().unwrap();
    device.open().map_err(|error| volseggs_testing::skip_device(name, &error.to_string())).ok().map(|_| device)
}

/// `volseggs train` with [`train_arguments`].
pub fn train(root: &Path, name: &str, more: &[&str]) -> Command {
    let mut command = volseggs();
    command.args(train_arguments(root, name, more));
    command
}

/// The bytes of a run's newest scene and optimiser.
pub fn newest_bytes(run: &Path) -> (Vec<u8>, Vec<u8>) {
    let (_, path) = checkpoint::list(run).pop().unwrap();
    let read = |name: &str| std::fs::read(path.join(name)).unwrap();
    (read("scene.safetensors"), read("optimizer.safetensors"))
}

/// Reads a JSON file.
pub fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// Returns the lines of a run's `metrics.jsonl`, without the fields that depend on the clock.
pub fn metrics(run: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(run.join("metrics.jsonl")).unwrap();
    let without_times = |line: &str| {
        let mut value: Value = serde_json::from_str(line).unwrap();
        let object = value.as_object_mut().unwrap();
        assert!(object.remove("seconds").unwrap().as_f64().unwrap() > 0.0);
        assert!(object.remove("milliseconds").unwrap().is_object());
        value
    };
    text.lines().map(without_times).collect()
}

/// Returns the names of a folder's entries, sorted.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// Runs a command that must be refused: exit code 2, nothing on standard output, and one error on standard error that
/// contains every one of `words`. Returns standard error.
pub fn refused(command: &mut Command, words: &[&str]) -> String {
    let output = command.assert().code(2).get_output().clone();
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(output.stdout.is_empty(), "standard output: {}", String::from_utf8_lossy(&output.stdout));
    assert_eq!(text.lines().filter(|l| l.starts_with("error:")).count(), 1, "{text}");
    for word in words {
        assert!(text.contains(word), "`{word}` is not in: {text}");
    }
    text
}

/// Returns a path under `root` as text.
pub fn text(root: &Path, path: &str) -> String {
    let path: PathBuf = root.join(path);
    path.display().to_string()
}
