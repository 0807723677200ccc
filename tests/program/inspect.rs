//! `volseggs inspect`: what it writes, and what it checks of a run.

use crate::common::{names, refused};
use crate::outputs::{call, with_run, write_volume};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

#[test]
fn inspect_replaces_only_its_own_pictures_and_fails_on_damaged_files() {
    let folder = with_run();
    let root = folder.path();
    write_volume(root);
    std::fs::write(root.join("photo.png"), "a photograph").unwrap();
    let inspect = |picture: &str| call(root, &format!("inspect v_0.raw --picture {picture}"));
    refused(&mut inspect("photo.png"), &["photo.png", "not made by volseggs"]);
    refused(&mut inspect("h.jpg"), &["h.jpg", ".png"]);
    refused(&mut inspect("missing/h.png"), &["no folder missing"]);
    for _ in 0..2 {
        inspect("h.png").assert().success();
    }
    std::fs::create_dir(root.join("early")).unwrap();
    std::fs::copy(root.join("run/run.json"), root.join("early/run.json")).unwrap();
    let early = call(root, "inspect early --json").assert().success();
    let early: Value = serde_json::from_slice(&early.get_output().stdout).unwrap();
    assert_eq!((&early["kind"], &early["checkpoints"]), (&json!("run"), &json!([])));
    call(root, "export run --out scene.ply").assert().success();
    call(root, "inspect scene.ply").assert().success();
    let mut bytes = std::fs::read(root.join("scene.ply")).unwrap();
    let end = bytes.len();
    bytes[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
    std::fs::write(root.join("scene.ply"), bytes).unwrap();
    call(root, "inspect scene.ply").assert().code(2);
}

#[test]
fn inspect_checks_every_file_of_a_run() {
    let folder = with_run();
    let root = folder.path();
    std::fs::write(root.join("run/edits.json"), "{\"format\": 1, \"operations\": [], \"undone\": []}").unwrap();
    let shown = call(root, "inspect run").assert().success().get_output().stdout.clone();
    let shown = String::from_utf8(shown).unwrap();
    for words in ["ok   run.json: volseggs, complete after 80 steps", "ok   config.toml", "segments: ", "Gaussians"] {
        assert!(shown.contains(words), "{words} is not in:\n{shown}");
    }
    let files: Vec<PathBuf> = ["run.json", "config.toml", "edits.json", "segments/segments.safetensors"]
        .into_iter()
        .map(PathBuf::from)
        .chain(["state.json", "scene.safetensors", "optimizer.safetensors"].map(|name| {
            let newest = names(&root.join("run/checkpoints")).pop().unwrap();
            Path::new("checkpoints").join(newest).join(name)
        }))
        .collect();
    for file in files {
        let path = root.join("run").join(&file);
        let whole = std::fs::read(&path).unwrap();
        let mut flipped = whole.clone();
        flipped[whole.len() / 2] ^= 0x40;
        let is_text = file.extension().is_none_or(|e| e != "safetensors");
        let cut = &whole[..whole.len() / 2];
        for damaged in [&[][..], &vec![0; whole.len()], cut, if is_text { cut } else { &flipped }] {
            std::fs::write(&path, damaged).unwrap();
            for more in ["", " --json"] {
                let output = call(root, &format!("inspect run{more}")).assert().code(2).get_output().clone();
                let said = String::from_utf8(output.stderr).unwrap();
                let name = file.file_name().unwrap().to_str().unwrap();
                assert!(said.contains(name), "{name} is not in: {said}");
                assert!(!output.stdout.is_empty(), "what is whole is shown");
            }
        }
        std::fs::write(&path, whole).unwrap();
    }
    call(root, "inspect run").assert().success();
}
