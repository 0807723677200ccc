//! What is measured of segments in space, against bodies of known size and motion: volume, centroid and velocity of
//! `track`, labels on voxels, in the physical units of the data. Voxels have three different sides, the first axis runs
//! backwards, and the origin is far away.

use crate::common::{json, run_json, volseggs};
use serde_json::Value;
use std::io::Write as _;
use std::path::Path;
use tempfile::TempDir;

/// Voxels along the axes, their sides in millimetres, and the centre of the first one.
const DIMS: [usize; 3] = [54, 45, 36];
const SIDES: [f64; 3] = [1.5, 1.8, 2.25];
const ORIGIN: [f64; 3] = [1070.5, -422.0, 20.0];
const STEPS: usize = 8;
/// First and last time in seconds.
const TIMES: [f64; 2] = [100.0, 200.0];
/// Cube root of a voxel's volume.
const VOXEL: f64 = 1.825;

/// A ball: its centre from the middle of the volume and its radius, at a time in [0, 1].
type Ball = fn(f64) -> ([f64; 3], f64);

/// A scene: its balls, each inside of the one before, and the control points of its transfer function: values with a
/// colour and with an opacity.
struct Scene {
    balls: Vec<Ball>,
    colours: &'static str,
    opacity: &'static str,
    /// Names of the label volumes' labels.
    names: &'static str,
}

const OPAQUE: &str = "[[0,0],[0.49,0],[0.51,0.8],[1,0.8]]";
const THIN: &str = "[[0,0],[0.49,0],[0.51,0.02],[1,0.02]]";
const RED: &str = "[[0,\"#d7263d\"],[1,\"#d7263d\"]]";

/// The offset of a constant motion by `by` in all.
fn linear(by: [f64; 3], time: f64) -> [f64; 3] {
    by.map(|v| v * (time - 0.5))
}

fn middle() -> [f64; 3] {
    std::array::from_fn(|k| {
        let sign = if k == 0 { -1.0 } else { 1.0 };
        ORIGIN[k] + sign * 0.5 * SIDES[k] * (DIMS[k] - 1) as f64
    })
}

fn places(scene: &Scene, time: f64) -> Vec<([f64; 3], f64)> {
    let middle = middle();
    let at = |ball: &Ball| {
        let (offset, radius) = ball(time);
        (std::array::from_fn(|k| middle[k] + offset[k]), radius)
    };
    scene.balls.iter().map(at).collect()
}

fn nrrd(path: &Path, kind: &str, bytes: &[u8]) {
    let [x, y, z] = DIMS;
    let [a, b, c] = SIDES;
    let [i, j, k] = ORIGIN;
    let mut file = std::fs::File::create(path).unwrap();
    write!(
        file,
        "NRRD0005\ntype: {kind}\ndimension: 3\nspace: left-posterior-superior\nsizes: {x} {y} {z}\n\
         space directions: (-{a},0,0) (0,{b},0) (0,0,{c})\nspace origin: ({i},{j},{k})\n\
         space units: \"mm\" \"mm\" \"mm\"\nendian: little\nencoding: raw\n\n"
    )
    .unwrap();
    file.write_all(bytes).unwrap();
}

/// Writes the scene as volumes and labels, prepares it and trains it, and finds its segments.
fn run(scene: &Scene) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let mut labels = Vec::new();
    for step in 0..STEPS {
        let balls = places(scene, step as f64 / (STEPS - 1) as f64);
        let (mut values, mut ids) = (Vec::new(), Vec::new());
        for v in 0..DIMS.iter().product::<usize>() {
            let index = [v % DIMS[0], v / DIMS[0] % DIMS[1], v / (DIMS[0] * DIMS[1])];
            let place: [f64; 3] = std::array::from_fn(|k| {
                let sign = if k == 0 { -1.0 } else { 1.0 };
                ORIGIN[k] + sign * SIDES[k] * index[k] as f64
            });
            // distance to each surface as a value around one half, over 4 mm
            let inside = |(centre, radius): &([f64; 3], f64)| {
                let away = (0..3).map(|k| (place[k] - centre[k]).powi(2)).sum::<f64>().sqrt();
                (0.5 + (radius - away) / 4.0).clamp(0.0, 1.0)
            };
            let depth: Vec<f64> = balls.iter().map(inside).collect();
            let value = if let [shell, core] = depth[..] { 0.4 * shell + 0.5 * core } else { depth[0] };
            values.extend((value as f32).to_le_bytes());
            ids.push(depth.iter().filter(|d| **d > 0.5).count() as u8);
        }
        nrrd(&root.join(format!("v{step}.nrrd")), "float", &values);
        nrrd(&root.join(format!("l{step}.nrrd")), "uint8", &ids);
        labels.push(format!("l{step}.nrrd"));
    }
    let Scene { colours, opacity, names, .. } = scene;
    let transfer =
        format!("name = \"scene\"\nrange = [0.0, 1.0]\nunit_length = 0.01\ncolors = {colours}\nopacity = {opacity}\n");
    std::fs::write(root.join("tf.toml"), transfer).unwrap();
    let times: Vec<String> =
        (0..STEPS).map(|i| (TIMES[0] + (TIMES[1] - TIMES[0]) * i as f64 / (STEPS - 1) as f64).to_string()).collect();
    volseggs()
        .current_dir(root)
        .args(["prepare", "--volume", "v*.nrrd", "--transfer-function", "tf.toml", "--out", "data", "--labels"])
        .args(&labels)
        .args(["--label-names", names, "--time-values", &times.join(",")])
        .args("--size 64 --side 1.4 --times 8 --views 10 --test-views 4 --segment-views 0 --no-label-images".split(' '))
        .assert()
        .success();
    let mut train = volseggs();
    train.current_dir(root).args(["train", "--data", "data", "--out", "run", "--config", "quick"]);
    for set in [
        "init.points=1500",
        "densify.budget=1500",
        "model.resolution=16",
        "model.channels=8",
        "model.width=32",
        "stages.warmup_steps=100",
        "stages.joint_steps=600",
        "optim.warmup_decay_steps=600",
        "output.eval_every=5000",
        "output.checkpoint_every=5000",
    ] {
        train.args(["--set", set]);
    }
    train.assert().success();
    run_json(root, &["segment", "coarse", "run"]);
    folder
}

/// The name of the segment whose colour has the most of a channel.
fn coloured(root: &Path, channel: usize) -> String {
    let listed = run_json(root, &["segment", "list", "run"]);
    let segments = listed["segments"].as_array().or_else(|| listed.as_array()).unwrap().clone();
    let most = |s: &Value| {
        let colour: Vec<f64> = s["colour"].as_array().unwrap().iter().map(|c| c.as_f64().unwrap()).collect();
        colour[channel] - colour.iter().sum::<f64>() / 3.0
    };
    let best = segments.iter().max_by(|a, b| most(a).total_cmp(&most(b))).unwrap();
    best["name"].as_str().unwrap().to_owned()
}

fn triple(value: &Value) -> [f64; 3] {
    std::array::from_fn(|k| value[k].as_f64().unwrap())
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

fn volume(radius: f64) -> f64 {
    4.0 / 3.0 * std::f64::consts::PI * radius.powi(3)
}

/// Tracks the segment at the trained times and compares it with a ball without the one inside of it. Returns the ratios
/// of the volumes.
fn check(root: &Path, scene: &Scene, name: &str, ball: usize, tolerance: f64) -> Vec<f64> {
    let times: Vec<f64> = (0..STEPS).map(|i| i as f64 / (STEPS - 1) as f64).collect();
    let mut arguments = vec!["track".to_owned(), "run".into(), "--segment".into(), name.into()];
    times.iter().for_each(|t| arguments.extend(["--at".into(), t.to_string()]));
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let found = run_json(root, &arguments);
    let units = &found[0]["units"];
    assert_eq!((&units["volume"], &units["centroid"]), (&"mm^3".into(), &"mm".into()), "{units}");
    let columns = std::fs::read_to_string(root.join("run/track").join(name).join("columns.csv")).unwrap();
    assert!(columns.contains("volume,mm^3,"), "{columns}");
    let of = |time: f64| places(scene, time)[ball];
    let seconds = TIMES[1] - TIMES[0];
    let (first, last) = (of(0.0).0, of(1.0).0);
    let exact: [f64; 3] = std::array::from_fn(|k| (last[k] - first[k]) / seconds);
    let speed = distance(exact, [0.0; 3]);
    let mut ratios = Vec::new();
    for (row, time) in found[0]["statistics"].as_array().unwrap().iter().zip(&times) {
        let (centre, radius) = of(*time);
        let inner = places(scene, *time).get(ball + 1).map_or(0.0, |(_, radius)| volume(*radius));
        let ratio = row["volume"].as_f64().unwrap() / (volume(radius) - inner);
        assert!((ratio - 1.0).abs() < tolerance, "{name} at {time}: {ratio} of its volume; {row}");
        let off = distance(triple(&row["centroid"]), centre);
        assert!(off < VOXEL, "{name} at {time}: {off} mm off; {row}");
        let velocity = triple(&row["velocity"]);
        // what stands may drift by a voxel in all
        let slack = if speed > 0.0 { 0.05 * speed } else { VOXEL / seconds };
        assert!(distance(velocity, exact) < slack, "{name} at {time}: {velocity:?}, not {exact:?}");
        assert_eq!(row["status"], "tracked", "{row}");
        assert!(row["trained_distance"].as_f64().unwrap() < 1e-9, "{row}");
        let physical = TIMES[0] + seconds * time;
        assert!((row["physical_time"].as_f64().unwrap() - physical).abs() < 1e-3, "{row}");
        ratios.push(ratio);
    }
    ratios
}

/// The Dice coefficients of the labels of one time, by name of the true label.
fn dice(root: &Path) -> Vec<(String, f64)> {
    let found =
        run_json(root, &["export", "run", "--format", "nrrd", "--time", "0", "--out", "l.nrrd", "--truth", "l0.nrrd"]);
    let shares = found["volumes"][0]["counted_shares"].as_array().unwrap().clone();
    assert!(shares.iter().all(|share| share.as_f64().is_some_and(|s| s > 0.5)), "{found}");
    let scores = found["agreement"]["segments"].as_array().unwrap();
    scores.iter().map(|s| (s["truth"].as_str().unwrap().to_owned(), s["dice"].as_f64().unwrap())).collect()
}

fn spread(ratios: &[f64]) -> f64 {
    let low = ratios.iter().copied().fold(f64::INFINITY, f64::min);
    ratios.iter().copied().fold(0.0, f64::max) / low
}

#[test]
fn an_opaque_ball_moves_at_its_speed_and_keeps_its_volume() {
    let scene = Scene {
        balls: vec![(|t: f64| (linear([30.0, 20.0, 10.0], t), 14.0)) as Ball],
        colours: RED,
        opacity: OPAQUE,
        names: "1=ball",
    };
    let folder = run(&scene);
    let root = folder.path();
    let name = coloured(root, 0);
    let ratios = check(root, &scene, &name, 0, 0.1);
    assert!(spread(&ratios) < 1.05, "{ratios:?}");
    let dice = dice(root);
    assert!(dice.iter().all(|(_, dice)| *dice >= 0.9), "{dice:?}");
    let record = json(&root.join("data/prepare.json"));
    assert!(record["calibration"]["space"].is_object(), "{record}");
}

#[test]
fn a_translucent_ball_is_as_large_as_it_is() {
    let scene = Scene {
        balls: vec![(|t: f64| (linear([-10.0, 15.0, 12.0], t), 18.0)) as Ball],
        colours: RED,
        opacity: THIN,
        names: "1=ball",
    };
    let folder = run(&scene);
    let root = folder.path();
    let ratios = check(root, &scene, &coloured(root, 0), 0, 0.2);
    assert!(spread(&ratios) < 1.05, "{ratios:?}");
    let dice = dice(root);
    assert!(dice.iter().all(|(_, dice)| *dice >= 0.85), "{dice:?}");
}

#[test]
fn a_translucent_shell_and_its_opaque_core_have_their_own_places() {
    let scene = Scene {
        balls: vec![
            (|t: f64| (linear([12.0, -8.0, 10.0], t), 24.0)) as Ball,
            (|t: f64| (linear([12.0, -8.0, 10.0], t), 12.0)) as Ball,
        ],
        colours: "[[0,\"#2f6fd0\"],[0.6,\"#2f6fd0\"],[0.61,\"#d7263d\"],[1,\"#d7263d\"]]",
        opacity: "[[0,0],[0.19,0],[0.21,0.02],[0.63,0.02],[0.65,0.8],[1,0.8]]",
        names: "1=shell,2=core",
    };
    let folder = run(&scene);
    let root = folder.path();
    check(root, &scene, &coloured(root, 2), 0, 0.2);
    let dice = dice(root);
    assert!(dice.iter().all(|(_, dice)| *dice >= 0.85), "{dice:?}");
}

#[test]
fn a_ball_that_doubles_its_volume_does_so() {
    let scene = Scene {
        balls: vec![(|t: f64| ([0.0; 3], 13.0 * (1.0 + t).cbrt())) as Ball],
        colours: RED,
        opacity: OPAQUE,
        names: "1=ball",
    };
    let folder = run(&scene);
    let root = folder.path();
    let ratios = check(root, &scene, &coloured(root, 0), 0, 0.1);
    let growth = ratios[STEPS - 1] / ratios[0];
    assert!((growth - 1.0).abs() < 0.05, "it grows by {} of what it should: {ratios:?}", growth);
}
