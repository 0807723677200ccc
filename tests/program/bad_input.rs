//! Broken datasets and options: exit code 2, one message that names the place, and no run folder.

use crate::common::{SIZE, dataset, refused, train, volseggs};
use image::RgbaImage;
use serde_json::{Value, json};
use std::path::Path;

/// Checks that training on the dataset under `root` is refused with a message that contains `words`, before anything is
/// written.
fn train_refused(root: &Path, more: &[&str], arguments: &[&str], words: &[&str]) {
    let message = refused(train(root, "run", more).args(arguments), words);
    assert!(!root.join("run").exists(), "a run folder is left after: {message}");
}

/// As [`train_refused`], after `edit` has changed the JSON of the training split.
fn json_refused(edit: impl Fn(&mut Value), words: &[&str]) {
    let root = dataset();
    let path = root.path().join("data/transforms_train.json");
    let mut value = crate::common::json(&path);
    edit(&mut value);
    std::fs::write(&path, value.to_string()).unwrap();
    let words: Vec<&str> = words.iter().chain(&["transforms_train.json"]).copied().collect();
    train_refused(root.path(), &[], &[], &words);
}

/// As [`json_refused`], for a change of the text.
fn text_refused(edit: impl Fn(&str) -> String, words: &[&str]) {
    let root = dataset();
    let path = root.path().join("data/transforms_train.json");
    let text = edit(&std::fs::read_to_string(&path).unwrap());
    std::fs::write(&path, text).unwrap();
    let words: Vec<&str> = words.iter().chain(&["transforms_train.json"]).copied().collect();
    train_refused(root.path(), &[], &[], &words);
}

#[test]
fn truncated_or_broken_json() {
    text_refused(|t| t[..t.len() * 2 / 3].to_owned(), &["ends too early", "line ", "truncated"]);
    text_refused(|_| String::new(), &["line "]);
    text_refused(|t| t.replacen(':', "=", 3), &["not JSON", "line "]);
    text_refused(|_| "[]".into(), &["not a JSON object", "frames"]);
}

#[test]
fn invalid_numbers() {
    for poison in ["NaN", "-Infinity", "1e999"] {
        let poisoned = |t: &str| {
            let mut value: Value = serde_json::from_str(t).unwrap();
            value["frames"][23]["transform_matrix"][1][2] = json!("here");
            value.to_string().replace("\"here\"", poison)
        };
        text_refused(poisoned, &["frame 23", "`transform_matrix`", "entry (1, 2)", "NaN or infinite"]);
    }
    json_refused(|v| v["frames"][2]["time"] = json!("late"), &["frame 2", "`time`", "a string"]);
    json_refused(|v| v["camera_angle_x"] = json!(-0.5), &["`camera_angle_x`", "-0.5"]);
}

#[test]
fn matrices_of_another_shape_or_not_rigid() {
    json_refused(
        |v| v["frames"][1]["transform_matrix"] = json!([[1.0, 0.0], [0.0, 1.0]]),
        &["frame 1", "`transform_matrix`", "2 rows"],
    );
    json_refused(
        |v| v["frames"][1]["transform_matrix"][2] = json!([0.0, 1.0, 0.0]),
        &["frame 1", "`transform_matrix`", "row 2"],
    );
    json_refused(
        |v| v["frames"][4]["transform_matrix"][0][0] = json!(7.0),
        &["frame 4", "`transform_matrix`", "orthonormal"],
    );
    json_refused(|v| v["frames"][4]["transform_matrix"] = Value::Null, &["frame 4", "`transform_matrix`"]);
}

#[test]
fn times_outside_their_range() {
    json_refused(|v| v["frames"][5]["time"] = json!(1.5), &["frame 5", "`time`", "1.5", "[0, 1]"]);
    json_refused(|v| v["frames"][0]["time"] = json!(-0.01), &["frame 0", "`time`", "-0.01"]);
    json_refused(|v| drop(v["frames"][3].as_object_mut().unwrap().remove("time")), &["frame 3", "`time`", "missing"]);
    json_refused(|v| v["frames"] = json!([]), &["`frames`", "empty"]);
}

#[test]
fn missing_broken_or_odd_images() {
    let root = dataset();
    let image = root.path().join("data/train/r_004.png");
    let whole = std::fs::read(&image).unwrap();
    let words = ["r_004.png", "frame 4", "`file_path`", "transforms_train.json"];
    let with = |problem: &'static str| [words.as_slice(), &[problem]].concat();

    std::fs::remove_file(&image).unwrap();
    train_refused(root.path(), &[], &[], &with("missing"));
    std::fs::write(&image, &whole[..whole.len() / 2]).unwrap();
    train_refused(root.path(), &[], &[], &with("not a readable PNG"));
    RgbaImage::new(SIZE, SIZE / 2).save(&image).unwrap();
    train_refused(root.path(), &[], &[], &with("32x16"));
    std::fs::write(&image, &whole).unwrap();
    train_refused(root.path(), &["data.downscale=5"], &[], &["transforms_train.json", "`downscale`", "32x32"]);
    std::fs::remove_file(root.path().join("data/test/r_002.png")).unwrap();
    train_refused(root.path(), &[], &[], &["r_002.png", "frame 2", "transforms_test.json"]);
}

#[test]
fn empty_images() {
    let root = dataset();
    for name in crate::common::names(&root.path().join("data/train")) {
        RgbaImage::new(SIZE, SIZE).save(root.path().join("data/train").join(name)).unwrap();
    }
    train_refused(root.path(), &[], &[], &["visual hull", "empty", "Hint"]);
}

#[test]
fn missing_files_and_folders() {
    let root = tempfile::tempdir().unwrap();
    train_refused(root.path(), &[], &[], &["data", "transforms_train.json", "cannot read"]);
    for command in ["eval", "render", "export"] {
        let run = crate::common::text(root.path(), "nothing");
        let mut program = volseggs();
        program.args([command, run.as_str()]);
        if command != "eval" {
            program.args(["--out", &crate::common::text(root.path(), "out")]);
        }
        refused(&mut program, &["nothing", "no checkpoint"]);
        assert!(!root.path().join("out").exists());
    }
    let missing = crate::common::text(root.path(), "nothing");
    refused(volseggs().args(["inspect", &missing]), &["nothing: not found", "a volume, a dataset or a run"]);
    let out = crate::common::text(root.path(), "out");
    refused(volseggs().args(["prepare", "--volume", &missing, "--out", &out]), &["nothing", "does not exist"]);
    refused(volseggs().args(["sweep", &missing]), &["nothing: not found", "a sweep file"]);
    assert!(!root.path().join("out").exists());
}

#[test]
fn invalid_options() {
    let root = dataset();
    let cases: &[(&[&str], &[&str], &[&str])] = &[
        (&[], &["--device", "tpu"], &["\"tpu\"", "flex"]),
        (&["data.background=mauve"], &[], &["data.background", "mauve", "#rrggbb"]),
        (&["data.background=#12345g"], &[], &["data.background", "#12345g"]),
        (&["model.sh_degree=7"], &[], &["model.sh_degree", "7", "0, 2 or 4"]),
        (&["init.points=0"], &[], &["init.points", "at least 1"]),
        (&["init.opacity=1.5"], &[], &["init.opacity", "1.5"]),
        (&["model.channels=0"], &[], &["model.channels"]),
        (&["stages.warmup_steps=0", "stages.joint_steps=0"], &[], &["stages.joint_steps", "nothing to train"]),
        (&["data.downscale=0"], &[], &["downscale"]),
        (&["stages.joint_steps=-3"], &[], &["stages.joint_steps", "-3", "--set"]),
        (&["loss.kind=l3"], &[], &["loss.kind", "l3"]),
        (&["loss.disim=0.1"], &[], &["unknown key", "loss.disim", "loss.dssim"]),
        (&["loss"], &[], &["--set", "KEY=VALUE"]),
        (&[], &["--config", "bestt"], &["bestt", "best"]),
    ];
    for (more, arguments, words) in cases {
        train_refused(root.path(), more, arguments, words);
    }
}

#[test]
fn negative_values_are_refused_by_their_own_option_and_no_message_names_a_rust_error() {
    let root = dataset();
    let scene = "prepare --synthetic jets --out out";
    for (arguments, words) in [
        (&format!("{scene} --seed -1")[..], &["'-1'", "--seed", "expected a whole number, 0 or above"][..]),
        (&format!("{scene} --steps -1,2"), &["'-1'", "--steps", "expected a whole number, 0 or above"]),
        (&format!("{scene} --test-views -3"), &["'-3'", "--test-views", "whole number"]),
        (&format!("{scene} --memory -1G"), &["'-1G'", "--memory"]),
        ("render run --out out --fps nan", &["'nan'", "--fps", "expected a whole number, 0 or above"]),
        ("render run --out out --fps -5", &["'-5'", "--fps"]),
        (
            "train --data data --out out --set seed=99999999999999999999",
            &["seed", "expected a whole number, 0 or above"],
        ),
    ] {
        let text = refused(volseggs().current_dir(root.path()).args(arguments.split(' ')), words);
        for rust in ["unexpected argument", "invalid digit", "i128", "u64", "TOML value"] {
            assert!(!text.contains(rust), "{arguments}: {text}");
        }
        assert!(!root.path().join("out").exists(), "{arguments}");
    }
}
