//! Sizes that no machine has, and files that are none: refused with exit code 2 and a message that names the key or the
//! file, before anything is allocated or waited for.
#![cfg(target_os = "linux")]

use crate::common::{BINARY, dataset, refused, text, train, train_arguments, volseggs};
use assert_cmd::Command;
use std::path::Path;
use std::time::Duration;

/// The program with 8 GB of address space, as batch systems grant it.
fn confined(arguments: &[String]) -> Command {
    let mut shell = Command::new("sh");
    shell.args(["-c", "ulimit -v 8000000; exec \"$0\" \"$@\"", BINARY]).args(arguments);
    shell.timeout(Duration::from_secs(120));
    for (name, _) in std::env::vars_os() {
        if name.to_string_lossy().starts_with("VOLSEGGS_") {
            shell.env_remove(name);
        }
    }
    shell
}

fn pipe(path: &Path) {
    rustix::fs::mknodat(rustix::fs::CWD, path, rustix::fs::FileType::Fifo, rustix::fs::Mode::RUSR, 0).unwrap();
}

#[test]
fn sizes_that_do_not_fit_into_memory_are_refused_by_key() {
    let root = dataset();
    let cases: [(&[&str], &str); 10] = [
        (&["init.points=2000000000"], "init.points = 2000000000"),
        (&["model.resolution=20000"], "model.resolution = 20000"),
        (&["model.resolution=64", "model.channels=64", "model.levels=60"], "model.levels = 60"),
        (&["model.time_knots=1000000000"], "model.time_knots = 1000000000"),
        (&["model.channels=1000000"], "model.channels = 1000000"),
        (&["model.width=1000000"], "model.width = 1000000"),
        (&["model.encoder=implicit", "model.width=1000000"], "model.width = 1000000"),
        (&["model.encoder=implicit", "model.implicit_width=1000000"], "model.implicit_width = 1000000"),
        (&["densify.budget=1000000000000", "densify.every=1"], "densify.budget = 1000000000000"),
        (
            &["init.points=9223372036854775807", "model.levels=9223372036854775807"],
            "model.levels = 9223372036854775807",
        ),
    ];
    for (more, key) in cases {
        refused(&mut confined(&train_arguments(root.path(), "run", more)), &[key, "needs about", "--memory"]);
        assert!(!root.path().join("run").exists(), "{key}");
    }
    let mut small = confined(&train_arguments(root.path(), "run", &[]));
    small.args(["--stop-after", "1"]).assert().success();
}

#[test]
fn images_that_do_not_fit_are_refused_before_they_are_decoded() {
    let root = dataset();
    let mut program = train(root.path(), "run", &[]);
    refused(program.args(["--memory", "50k"]), &["data.downscale", "24 images of 32x32", "larger factor"]);
}

#[test]
fn errors_about_invalid_values_name_the_key() {
    let root = dataset();
    for (set, words) in [
        ("init.scale=0", ["init.scale = 0", "above 0"]),
        ("init.scale=1e300", ["init.scale = 1e300", "too large, at most 3.4e38"]),
        ("optim.betas=[0.9, 1.0]", ["optim.betas[1] = 1", "between"]),
        ("output.keep=0", ["output.keep = 0", "at least 1"]),
        ("stages.joint_steps=many", ["stages.joint_steps", "a whole number, 0 or above"]),
        ("model=3", ["`model`", "a section"]),
    ] {
        let message = refused(&mut train(root.path(), "run", &[set]), &words);
        assert!(
            !message.contains("learning rate") && !message.contains("usize") && !message.contains("struct"),
            "{message}"
        );
    }
}

#[test]
fn pipes_and_folders_in_place_of_images_are_refused_at_once() {
    let root = dataset();
    let image = root.path().join("data/train/r_002.png");
    std::fs::remove_file(&image).unwrap();
    pipe(&image);
    let data = text(root.path(), "data");
    let words = ["r_002.png", "a pipe, not a regular file", "frame 2"];
    refused(train(root.path(), "run", &[]).timeout(Duration::from_secs(30)), &words);
    let mut inspect = volseggs();
    inspect.args(["inspect", &data]).timeout(Duration::from_secs(30));
    let output = inspect.output().unwrap();
    let message = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code().is_some_and(|c| c != 0) && message.contains("a pipe"), "{message}");

    std::fs::remove_file(&image).unwrap();
    std::fs::create_dir(&image).unwrap();
    refused(&mut train(root.path(), "run", &[]), &["r_002.png", "a folder, not a regular file"]);

    let json = root.path().join("data/transforms_train.json");
    std::fs::remove_file(&json).unwrap();
    pipe(&json);
    refused(train(root.path(), "run", &[]).timeout(Duration::from_secs(30)), &["transforms_train.json", "a pipe"]);
}

#[test]
fn pipes_in_place_of_volumes_and_sweep_files_are_refused() {
    let root = tempfile::tempdir().unwrap();
    let volumes = ["v.nrrd", "v.nhdr", "v.npy", "v.vti", "v.nii", "v.nii.gz", "v.raw"];
    volumes.iter().chain(&["sweep.toml"]).for_each(|name| pipe(&root.path().join(name)));
    for name in volumes {
        let (volume, out) = (text(root.path(), name), text(root.path(), "out"));
        let mut program = volseggs();
        program.args(["prepare", "--volume", &volume, "--transfer-function", "fire", "--out", &out]);
        refused(program.timeout(Duration::from_secs(30)), &[name, "a pipe"]);
    }
    let mut program = volseggs();
    program.args(["sweep", "--dry-run", &text(root.path(), "sweep.toml")]);
    refused(program.timeout(Duration::from_secs(30)), &["sweep.toml", "a pipe"]);
}

#[test]
fn two_frames_with_the_same_image_are_refused() {
    let root = dataset();
    let path = root.path().join("data/transforms_train.json");
    let mut json = crate::common::json(&path);
    json["frames"][7]["file_path"] = json["frames"][3]["file_path"].clone();
    std::fs::write(&path, json.to_string()).unwrap();
    refused(&mut train(root.path(), "run", &[]), &["frame 7", "frame 3", "`file_path`", "transforms_train.json"]);
}

#[test]
fn oversized_and_invalid_sweeps_are_refused_at_once() {
    let root = dataset();
    let file = root.path().join("big.toml");
    let dry = |text: &str, words: &[&str]| {
        std::fs::write(&file, format!("{text}\n[data]\nballs = 'data'\n")).unwrap();
        let mut program = volseggs();
        program.args(["sweep", "--dry-run", "--out"]).arg(root.path().join("out")).arg(&file);
        refused(program.timeout(Duration::from_secs(30)), &[words, &["big.toml"]].concat());
    };
    let random = "[random]\ncount = 100000000000\n[random.keys]\n'loss.tv' = { low = 0.0, high = 1.0 }";
    dry(random, &["random.count", "100000000000", "at most"]);
    let axes: String = (0..12).map(|k| format!("'k.k{k}' = [1, 2, 3]\n")).collect();
    dry(&format!("[grid]\n{axes}"), &["grid.k.k", "531441 runs"]);
    dry("seeds = []", &["seeds", "empty list"]);
    dry("seeds = [-4]", &["seeds", "whole number, 0 or above"]);
    dry("set = { seed = -4 }", &["set.seed", "whole numbers from 0"]);
    std::fs::write(&file, "[data]\n'../../evil' = { synthetic = 'jets' }\n").unwrap();
    let mut program = volseggs();
    program.args(["sweep", "--out"]).arg(root.path().join("a/b/out")).arg(&file);
    refused(&mut program, &["data.../../evil", "cannot be a name"]);
    assert!(!root.path().join("evil").exists() && !root.path().join("a").exists());
}

#[test]
fn test_variables_do_not_break_training() {
    let root = dataset();
    let mut program = train(root.path(), "run", &[]);
    program.env("VOLSEGGS_TEST_SAM", "x").env("VOLSEGGS_REQUIRE_ANYTHING", "1").args(["--stop-after", "1"]);
    program.assert().success();
    refused(train(root.path(), "other", &[]).env("VOLSEGGS_SEEED", "1"), &["VOLSEGGS_SEEED", "did you mean"]);
}
