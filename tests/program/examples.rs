//! The programs in `examples/`, which are built with the tests.

use crate::common::{BINARY, dataset, run_json, train, volseggs};
use assert_cmd::Command;
use std::path::Path;
use volseggs::segment::segmentation::Segmentation;

fn example(name: &str) -> Command {
    Command::new(Path::new(BINARY).with_file_name("examples").join(name))
}

#[test]
fn a_volume_becomes_a_picture_in_few_lines() {
    let out = tempfile::tempdir().unwrap();
    example("train_and_render").arg(out.path()).arg("3").assert().success();
    let picture = image::open(out.path().join("jets.png")).unwrap().to_rgb8();
    assert_eq!(picture.dimensions(), (128, 128));
    assert!(picture.pixels().any(|p| p.0 != [255; 3]), "something is drawn");
    let lines = include_str!("../../examples/train_and_render.rs").lines().count();
    assert!(lines <= 35, "{lines} lines");
}

#[test]
fn a_run_is_clicked_on_and_exported_and_a_dataset_trained_with_a_loss_of_its_own() {
    let folder = dataset();
    let root = folder.path();
    let scene = root.join("scene.safetensors");
    example("custom_loss").current_dir(root).args(["data", "scene.safetensors", "3"]).assert().success();
    assert!(scene.is_file());

    train(root, "run", &[]).assert().success();
    for arguments in [
        &["segment", "coarse", "run", "--clusters", "2"][..],
        &["segment", "masks", "run", "--views", "5", "--size", "64"],
        &["segment", "fine", "run", "--steps", "30", "--pixels", "256"],
    ] {
        volseggs().current_dir(root).args(arguments).assert().success();
    }
    let click = ["run", "2", "16", "16", "mine"];
    let printed = example("segment_by_click").current_dir(root).args(click).assert().success();
    assert!(String::from_utf8_lossy(&printed.get_output().stdout).starts_with("mine: "));
    let made = Segmentation::load(&root.join("run/segments/segments.safetensors")).unwrap();
    let mine = made.get("mine").unwrap().members.len();
    let listed = run_json(root, &["segment", "list", "run"]);
    assert!(mine > 0 && listed["segments"].as_array().unwrap().iter().any(|s| s["name"] == "mine"), "{listed}");

    example("export").current_dir(root).args(["run", "0.5", "half.ply"]).assert().success();
    assert!(std::fs::read(root.join("half.ply")).unwrap().starts_with(b"ply\n"));
    let refused = example("export").current_dir(root).args(["run", "0.5", "half.nrrd"]).assert().failure();
    assert!(String::from_utf8_lossy(&refused.get_output().stderr).contains("hold no Gaussians"));
}
