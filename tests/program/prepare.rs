//! `prepare`, `inspect` on volumes, and `demo`, as whole programs.

use crate::common::{SETTINGS, json, names, refused, text, volseggs};
use std::path::{Path, PathBuf};
use volseggs::data::dataset::{Dataset, OpenOptions};
use volseggs::data::{SplitName, Transforms};
use volseggs::volume::placement::published_side;

/// A series of raw volumes with a drifting ball, and labels of its inner part: 20 x 16 x 12 voxels, 3 steps.
fn write_series(root: &Path) {
    let dims = [20usize, 16, 12];
    for step in 0..3 {
        let (mut values, mut labels) = (Vec::new(), Vec::new());
        for i in 0..dims.iter().product::<usize>() {
            let p = [i % 20, i / 20 % 16, i / 320].map(|v| v as f64);
            let d = ((p[0] - 8.0 - step as f64).powi(2) + (p[1] - 7.5).powi(2) + (p[2] - 5.5).powi(2)).sqrt();
            let value = (100.0 * (6.0 - d)).clamp(0.0, 600.0) as u16;
            values.extend(value.to_be_bytes());
            labels.push(u8::from(d < 3.0) + 4 * u8::from((3.0..5.0).contains(&d)));
        }
        std::fs::write(root.join(format!("v_{step}.raw")), values).unwrap();
        std::fs::write(root.join(format!("l_{step}.raw")), labels).unwrap();
        let sidecar = "dims = [20, 16, 12]\nspacing = [1.0, 1.0, 1.5]\n";
        std::fs::write(root.join(format!("v_{step}.raw.toml")), format!("{sidecar}type = \"u16\"\nendian = \"big\"\n"))
            .unwrap();
        std::fs::write(root.join(format!("l_{step}.raw.toml")), format!("{sidecar}type = \"u8\"\n")).unwrap();
    }
}

/// Returns the arguments of `prepare` for small images of the series, into `root/NAME`.
fn arguments(root: &Path, name: &str) -> Vec<String> {
    let few = "--size 40x32 --times 2 --views 3 --test-views 5 --segment-views 2";
    let mut all =
        vec!["prepare".to_owned(), "--volume".into(), text(root, "v_*.raw"), "--out".into(), text(root, name)];
    all.extend(few.split(' ').map(String::from));
    all
}

#[test]
fn a_series_becomes_a_dataset_with_ground_truth() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    write_series(root);
    let labels = text(root, "l_*.raw");
    let mut command = volseggs();
    command.args(arguments(root, "data")).args(["--labels", &labels, "--label-names", "1=core,4=shell", "--json"]);
    let record: serde_json::Value = serde_json::from_slice(&command.assert().success().get_output().stdout).unwrap();
    assert_eq!((&record["dims"], &record["transfer_function"]), (&serde_json::json!([20, 16, 12]), &"ramp".into()));
    assert_eq!(record["segments"], serde_json::json!(["core", "shell"]));
    // of the height, which is the shorter side
    let half = record["half_size"][0].as_f64().unwrap();
    assert!((half / (0.5 * published_side()) - 0.8).abs() < 1e-9, "{half}");
    let data = root.join("data");
    assert_eq!(
        names(&data),
        [
            "contact-sheet.png",
            "labels",
            "prepare.json",
            "segments",
            "segments.json",
            "test",
            "train",
            "transfer-function.toml",
            "transforms_test.json",
            "transforms_train.json",
            "volumes"
        ]
    );
    let open = OpenOptions { downscale: 1, splits: &[SplitName::Train, SplitName::Test], max_views: None };
    let dataset = Dataset::open(&data, &open).unwrap();
    assert_eq!((dataset.train.images.width, dataset.train.images.height), (40, 32));
    assert_eq!((dataset.train.frames.len(), dataset.train.times()), (6, vec![0.0, 1.0]));
    assert_eq!(dataset.test.unwrap().times(), [0.0, 0.5, 1.0]);
    let segments = json(&data.join("segments.json"));
    assert_eq!(segments["segments"][1]["id"], 4);
    let pictures = names(&data.join("segments/core"));
    assert_eq!((pictures.len(), pictures[0].as_str()), (2 * 2 * 3, "r_0_step_0.png"), "{pictures:?}");
    assert_eq!(names(&data.join("volumes")), ["step_0.safetensors", "step_1.safetensors", "step_2.safetensors"]);
    // the dataset passes every check
    volseggs().args(["inspect", &text(root, "data")]).assert().success();
    // so does a volume of segment ids, whose tensors are not those of a scene
    let file = data.join("volumes/step_1.safetensors");
    let shown = volseggs().args(["inspect", file.to_str().unwrap(), "--json"]).assert().success();
    let shown: serde_json::Value = serde_json::from_slice(&shown.get_output().stdout).unwrap();
    assert_eq!((&shown["kind"], &shown["time"]), (&"segment ids".into(), &0.5.into()));
    assert!(shown["cells_by_id"]["4"].as_u64().unwrap() > 0, "{shown}");
    std::fs::write(&file, &std::fs::read(&file).unwrap()[..600]).unwrap();
    refused(volseggs().args(["inspect", file.to_str().unwrap()]), &["step_1.safetensors"]);
}

#[test]
fn connected_components_are_the_segments_of_unlabelled_volumes() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    write_series(root);
    let parts = |out: &str, value: &str, more: &[&str]| {
        let mut command = volseggs();
        command.args(arguments(root, out)).args(["--components", value, "--json"]).args(more);
        command
    };
    let output = parts("data", "100", &["--segment-steps", "own"]).assert().success();
    let record: serde_json::Value = serde_json::from_slice(&output.get_output().stdout).unwrap();
    assert_eq!(record["segments"], serde_json::json!(["part-1"]));
    let segments = json(&root.join("data/segments.json"));
    assert_eq!(segments["source"], "components");
    let pictures = names(&root.join("data/segments/part-1"));
    assert_eq!(pictures, ["r_0.png", "r_0_mask.png", "r_4.png", "r_4_mask.png"]);
    assert!(segments["segments"][0]["frames"][0]["pixels"].as_u64().unwrap() > 10);
    assert_eq!(segments["volumes"].as_array().unwrap().len(), 3);
    refused(&mut parts("none", "1e6", &[]), &["--components", "largest value", "lower value"]);
    refused(&mut parts("none", "100", &["--smallest-component", "5000"]), &["5000", "smaller minimum size"]);
    refused(&mut parts("none", "100", &["--labels", &text(root, "l_*.raw")]), &["--labels", "cannot be used"]);
    refused(&mut parts("none", "nan", &[]), &["finite"]);
}

#[test]
fn lighting_can_be_set_by_options() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let few = "prepare --synthetic layers --dims 24 --series-steps 2 --size 32 --times 1 --views 1 --test-views 2 \
               --segment-views 1 --no-label-images --out";
    let picture = |name: &str, light: &[&str]| {
        let few = few.split_whitespace();
        volseggs().args(few).arg(text(root, name)).args(light).assert().success();
        std::fs::read(root.join(name).join("test/r_1.png")).unwrap()
    };
    let plain = picture("plain", &[]);
    let dark = picture("dark", &["--ambient", "0.1", "--diffuse", "0.9", "--specular", "0"]);
    let shiny = picture("shiny", &["--specular", "0.9", "--shininess", "60"]);
    assert!(plain != dark && plain != shiny && dark != shiny);
    let made = std::fs::read_to_string(root.join("shiny/transfer-function.toml")).unwrap();
    assert!(
        made.contains("specular = 0.9") && made.contains("power = 60.0") && made.contains("ambient = 0.45"),
        "{made}"
    );
    let mut command = volseggs();
    command.args(few.split_whitespace()).arg(text(root, "none")).args(["--ambient", "-1"]);
    refused(&mut command, &["--ambient", "0 or above"]);
}

#[test]
fn the_poses_match_the_published_ones() {
    let folder = tempfile::tempdir().unwrap();
    let out = text(folder.path(), "data");
    let few = "prepare --synthetic shells --dims 8 --size 4 --no-label-images --segment-views 0 --out";
    volseggs().args(few.split(' ')).arg(&out).assert().success();
    let train = Transforms::read(&SplitName::Train.json_path(Path::new(&out))).unwrap();
    let test = Transforms::read(&SplitName::Test.json_path(Path::new(&out))).unwrap();
    assert_eq!((train.frames.len(), test.frames.len()), (600, 181));
    assert!((train.intrinsics.camera_angle_x.unwrap() - 0.523_598_775_598_298_8).abs() < 1e-15);
    let position = |t: &Transforms, i: usize| t.frames[i].camera_to_world.w_axis.truncate().to_array();
    for (at, want) in [
        (position(&train, 0), [0.361_645_238, 0.047_029_5, -4.014_569_486]),
        (position(&train, 450), [3.002_941_686, -1.793_839_5, 2.003_558_906]),
        (position(&test, 45), [2.850_418_146, 0.0, -2.850_418_146]),
    ] {
        assert!((0..3).all(|a| (at[a] - want[a]).abs() < 1e-6), "{at:?}");
    }
    assert_eq!((test.frames[45].time, test.frames[180].time), (24.0 / 99.0, 1.0));
}

#[test]
fn invalid_input_gives_one_error_and_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    write_series(root);
    let before = names(root);
    let with = |more: &[&str], words: &[&str]| {
        let mut command = volseggs();
        command.args(arguments(root, "data")).args(more);
        refused(&mut command, words);
        assert_eq!(names(root), before);
    };
    with(&["--transfer-function", "nothing"], &["nothing", "ramp", "fire"]);
    with(&["--steps", "0,3"], &["step 3", "3 steps"]);
    with(&["--radius", "0.2", "--side", "1"], &["radius 0.2", "outside"]);
    with(&["--segment-steps", "0"], &["--segment-steps", "no segment is rendered"]);
    with(&["--time-values", "0,2,1"], &["time"]);
    with(&["--labels", &text(root, "l_0.raw")], &["--labels", "1 steps"]);
    let volume = |inputs: &[&str], words: &[&str]| {
        let mut command = volseggs();
        command.args(["prepare", "--out", &text(root, "data"), "--volume"]).args(inputs.iter().map(|i| text(root, i)));
        refused(&mut command, words);
    };
    volume(&["none_*.raw"], &["none_*.raw"]);
    volume(&["v_1.raw", "v_0.raw"], &["v_0.raw"]);
    volume(&["absent.raw"], &["absent.raw"]);
    // a truncated file
    let bytes = std::fs::read(root.join("v_1.raw")).unwrap();
    std::fs::write(root.join("v_1.raw"), &bytes[..bytes.len() - 1]).unwrap();
    volume(&["v_*.raw"], &["v_1.raw", "7679", "7680"]);
    std::fs::write(root.join("v_1.raw"), &bytes).unwrap();
    std::fs::remove_file(root.join("v_1.raw")).unwrap();
    for end in ["raw", "raw.toml"] {
        std::fs::copy(root.join(format!("v_0.{end}")), root.join(format!("v_3.{end}"))).unwrap();
    }
    volume(&["v_*.raw"], &["v_1", "--allow-gaps"]);
    assert!(!root.join("data").exists());
}

#[test]
fn nan_voxels_are_reported_or_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let mut values: Vec<f32> = (0..4 * 4 * 4).map(|i| i as f32).collect();
    values[21] = f32::NAN;
    std::fs::write(root.join("v.raw"), values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>()).unwrap();
    std::fs::write(root.join("v.raw.toml"), "dims = [4, 4, 4]\ntype = \"f32\"\n").unwrap();
    let arguments = |name: &str| {
        let few = "--size 8 --views 1 --test-views 1".split(' ');
        let all = ["prepare", "--volume", &text(root, "v.raw"), "--out", &text(root, name)].map(String::from);
        all.into_iter().chain(few.map(String::from)).collect::<Vec<_>>()
    };
    refused(volseggs().args(arguments("a")), &["v.raw", "NaN", "--nan"]);
    volseggs().args(arguments("b")).args(["--nan", "-1"]).assert().success();
}

#[test]
fn inspect_shows_volumes() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    write_series(root);
    let picture = text(root, "h.png");
    let mut command = volseggs();
    command.args(["inspect", &text(root, "v_*.raw"), "--transfer-function", "fire", "--picture", &picture, "--json"]);
    let shown: serde_json::Value = serde_json::from_slice(&command.assert().success().get_output().stdout).unwrap();
    assert_eq!(shown["dims"], serde_json::json!([20, 16, 12]));
    assert_eq!((&shown["steps"], &shown["type"]), (&serde_json::json!(3), &serde_json::json!("u16")));
    assert!(image::open(&picture).unwrap().width() > 400);
    std::fs::write(root.join("other.xyz"), []).unwrap();
    refused(volseggs().args(["inspect", &text(root, "other.xyz")]), &["other.xyz", ".nrrd"]);
}

#[test]
fn inspect_skips_and_counts_nan_voxels() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let write = |name: &str, values: &[f32]| {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        std::fs::write(root.join(format!("{name}.raw")), bytes).unwrap();
        std::fs::write(root.join(format!("{name}.raw.toml")), "dims = [4, 4, 4]\ntype = \"f32\"\n").unwrap();
    };
    let mut values: Vec<f32> = (0..64).map(|i| 10.0 + i as f32).collect();
    (values[21], values[40]) = (f32::NAN, f32::INFINITY);
    write("v", &values);
    write("none", &[f32::NAN; 64]);
    let shown = |name: &str, more: &[&str]| {
        let mut command = volseggs();
        command.args(["inspect", &text(root, name)]).args(more);
        String::from_utf8(command.assert().success().get_output().stdout.clone()).unwrap()
    };
    let record: serde_json::Value =
        serde_json::from_str(&shown("v.raw", &["--json", "--picture", &text(root, "h.png")])).unwrap();
    assert_eq!((&record["range"], &record["not_finite"]), (&serde_json::json!([10.0, 73.0]), &2.into()));
    assert!(root.join("h.png").is_file());
    let lines = shown("v.raw", &[]);
    assert!(lines.contains("range    10 .. 73") && lines.contains("note: 2 voxels of all steps are NaN"), "{lines}");
    // no range to draw, but still a volume
    let record: serde_json::Value = serde_json::from_str(&shown("none.raw", &["--json"])).unwrap();
    assert_eq!((&record["range"], &record["not_finite"]), (&serde_json::Value::Null, &64.into()));
    let mut command = volseggs();
    command.args(["inspect", &text(root, "none.raw"), "--picture", &text(root, "n.png")]);
    refused(&mut command, &["none.raw", "no voxel of any step is finite"]);
}

#[test]
fn the_demo_writes_a_report_and_can_be_repeated() {
    let folder = tempfile::tempdir().unwrap();
    let out = text(folder.path(), "demo");
    let small = "demo --size 48 --json --set init.points=150 --set densify.budget=150 --set model.resolution=8 \
                 --set stages.warmup_steps=5 --set stages.joint_steps=15 --set output.eval_every=10 --out";
    let run = || volseggs().args(small.split_whitespace()).arg(&out).assert().success().get_output().stdout.clone();
    let first: serde_json::Value = serde_json::from_slice(&run()).unwrap();
    assert!(first["metrics"]["psnr"].as_f64().unwrap() > 5.0);
    let page = std::fs::read_to_string(Path::new(&out).join("report.html")).unwrap();
    for word in ["<html", "PSNR", "Turntable", "plume-1", "volseggs prepare", "data:image/png;base64,"] {
        assert!(page.contains(word) || page.to_lowercase().contains(&word.to_lowercase()), "{word}");
    }
    assert!(!page.contains("https://"));
    // the run is ready for clicks: colours, the segments clicked in them, and the affinity field
    let trained = format!("{out}/run");
    let listed: serde_json::Value = {
        let list = volseggs().args(["segment", "list", &trained, "--json"]).assert().success();
        serde_json::from_slice(&list.get_output().stdout).unwrap()
    };
    let listed = listed["segments"].as_array().unwrap();
    let origins: Vec<&str> = listed.iter().map(|s| s["origin"]["kind"].as_str().unwrap()).collect();
    assert!(origins.contains(&"coarse") && origins.contains(&"pick"), "{origins:?}");
    volseggs().args(["segment", "pick", &trained, "--view", "0", "--pixel", "24,24"]).assert().success();
    // again: the dataset is reused, the run is complete, the report is renewed, and the user's own segments survive
    let listed = || volseggs().args(["segment", "list", &trained]).assert().success().get_output().stdout.clone();
    volseggs().args(["segment", "coarse", &trained, "--replace"]).assert().success();
    let own = listed();
    let second: serde_json::Value = serde_json::from_slice(&run()).unwrap();
    assert_eq!(first["metrics"]["psnr"], second["metrics"]["psnr"]);
    assert_eq!(String::from_utf8_lossy(&listed()), String::from_utf8_lossy(&own));
    refused(volseggs().args(["demo", "--set", "nothing=1", "--out", &out]), &["nothing"]);
    let none = text(folder.path(), "none");
    refused(volseggs().args(["demo", "--set", "output.keep=0", "--out", &none]), &["output.keep"]);
    let mut many = volseggs();
    many.args(small.split_whitespace()).args([&out[..], "--set", "data.times=100"]);
    refused(&mut many, &["data.times"]);
    let foreign = text(folder.path(), "foreign");
    std::fs::create_dir_all(&foreign).unwrap();
    std::fs::write(folder.path().join("foreign/report.html"), "mine").unwrap();
    refused(volseggs().args(["demo", "--out", &foreign]), &["report.html"]);
    assert!(!Path::new(&none).exists(), "refused before anything is written");
    let mut other = volseggs();
    other.args(small.split_whitespace()).args([&out[..], "--set", "loss.tv=0.5"]);
    refused(&mut other, &["loss.tv"]);
}

#[test]
fn wide_lenses_and_paths_below_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let out = text(folder.path(), "wide");
    let few =
        ["--dims", "8", "--size", "16", "--times", "2", "--series-steps", "2", "--views", "2", "--test-views", "2"];
    let prepare = |more: &[&str]| {
        let mut command = volseggs();
        command.args(["prepare", "--synthetic", "jets"]).args(few).args(more);
        command
    };
    prepare(&["--fov", "120", "--out", &out]).assert().success();
    std::fs::write(folder.path().join("notes.txt"), "mine").unwrap();
    refused(&mut prepare(&["--out", &text(folder.path(), "notes.txt/data")]), &["notes.txt", "below a file"]);
    refused(
        volseggs().args(["inspect", &out, "--transfer-function", "fire"]),
        &["--transfer-function", "not a volume"],
    );
}

#[test]
fn raycast_compares_the_costs_of_volumes_and_of_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    write_series(root);
    volseggs().args(arguments(root, "data")).assert().success();
    let (run, data) = (text(root, "run"), text(root, "data"));
    volseggs().args(["train", "--data", &data, "--out", &run]).args(small()).assert().success();
    let raycast = |volume: &str, more: &[&str]| {
        let mut command = volseggs();
        command.args(["raycast", &run, "--volume", &text(root, volume), "--steps", "2", "--views", "4"]).args(more);
        command
    };
    let report = raycast("v_*.raw", &["--json"]).assert().success();
    let report: serde_json::Value = serde_json::from_slice(&report.get_output().stdout).unwrap();
    let volumes = &report["volumes"];
    // 3 steps of 20 x 16 x 12 voxels of two bytes
    assert_eq!((&volumes["steps"], &volumes["raw_bytes"]), (&3.into(), &(3 * 20 * 16 * 12 * 2).into()));
    assert_eq!((&volumes["loaded"], &volumes["views"]), (&2.into(), &4.into()));
    let scene = std::fs::metadata(newest_scene(&root.join("run"))).unwrap().len();
    assert_eq!(report["run"]["model_bytes"], scene);
    for side in [volumes, &report["run"]] {
        for what in ["load_seconds", "view_seconds", "peak_memory_bytes"] {
            assert!(side[what].as_f64().unwrap() > 0.0, "{what}: {report}");
        }
    }
    assert_eq!(report["run"]["preparation_seconds"], json(&root.join("data/prepare.json"))["seconds"]);
    // arguments after `--` stay behind it
    let mut last = volseggs();
    last.args([
        "--memory",
        "4G",
        "raycast",
        "--steps",
        "2",
        "--views",
        "4",
        "--json",
        "--volume",
        &text(root, "v_*.raw"),
        "--",
        &run,
    ]);
    last.assert().success();
    let table = raycast("v_*.raw", &[]).assert().success();
    let table = String::from_utf8(table.get_output().stdout.clone()).unwrap();
    for words in
        ["| | volume rendering | splatting |", "| data, MB | 0.02 |", "for all 3 steps", "4 views at 2 of 3 steps"]
    {
        assert!(table.contains(words), "{words}: {table}");
    }

    refused(&mut raycast("v_0.raw", &[]), &["--volume: 1 steps", "[20, 16, 12]", "was made of 3"]);
    refused(&mut raycast("no_*.raw", &[]), &["no_*.raw"]);
    std::fs::remove_file(root.join("data/prepare.json")).unwrap();
    refused(&mut raycast("v_*.raw", &[]), &["no prepare.json"]);
    std::fs::remove_file(root.join("run/run.json")).unwrap();
    refused(&mut raycast("v_*.raw", &[]), &["run.json"]);
}

/// Returns the settings of a training that takes a second.
fn small() -> Vec<&'static str> {
    SETTINGS.iter().flat_map(|set| ["--set", set]).collect()
}

fn newest_scene(run: &Path) -> PathBuf {
    volseggs::train::checkpoint::newest_scene(run).unwrap()
}
