//! The programs in `examples/`, which are built with the tests.

use crate::common::BINARY;
use assert_cmd::Command;
use std::path::Path;

#[test]
fn a_volume_becomes_a_picture_in_few_lines() {
    let out = tempfile::tempdir().unwrap();
    let example = Path::new(BINARY).with_file_name("examples").join("train_and_render");
    Command::new(example).arg(out.path()).arg("3").assert().success();
    let picture = image::open(out.path().join("jets.png")).unwrap().to_rgb8();
    assert_eq!(picture.dimensions(), (128, 128));
    assert!(picture.pixels().any(|p| p.0 != [255; 3]), "something is drawn");
    let lines = include_str!("../../examples/train_and_render.rs").lines().count();
    assert!(lines <= 35, "{lines} lines");
}
