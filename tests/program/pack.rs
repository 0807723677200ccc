//! `volseggs pack` as a whole program: a packed run is rendered, evaluated, segmented and edited like the run it was
//! made from, and not trained further.

use crate::common::{copy, json, names, refused, run_json, volseggs, with_segments};
use std::path::Path;
use volseggs::train::checkpoint::{list as checkpoints, newest_scene};

/// Returns the size of a run's newest scene file in bytes.
fn bytes(root: &Path, run: &str) -> u64 {
    let scene = newest_scene(&root.join(run)).unwrap();
    std::fs::metadata(scene).unwrap().len()
}

#[test]
fn a_packed_run_is_small_and_supports_everything_but_training() {
    let made = with_segments("pack", &["--clusters", "3", "--keep-outliers"]);
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    copy(&made.join("run"), &root.join("run"));
    let name = run_json(root, &["segment", "list", "run"])["segments"][0]["name"].as_str().unwrap().to_owned();
    run_json(root, &["edit", "recolour", "run", "--segment", &name, "--colour", "#00ff00"]);

    let report = run_json(root, &["pack", "run", "--out", "small"]);
    assert_eq!(report["gaussians"], 400);
    assert_eq!([&report["scene_bytes_before"], &report["scene_bytes"]], [bytes(root, "run"), bytes(root, "small")]);
    // 23 f32 per Gaussian become 6 + 20 bytes, and the field is halved
    assert!(3 * bytes(root, "small") < 2 * bytes(root, "run"), "{report}");
    assert_eq!(names(&root.join("small")), ["checkpoints", "config.toml", "edits.json", "run.json", "segments"]);
    assert_eq!(names(&root.join("small/segments")), ["segments.safetensors"]);
    assert_eq!(run_json(root, &["inspect", "small"])["readable"], 1);

    // pictures, numbers, segments, edits
    let psnr = |run: &str| run_json(root, &["eval", run])["psnr"].as_f64().unwrap();
    let (before, after) = (psnr("run"), psnr("small"));
    assert!((before - after).abs() < 0.3, "{before} dB, then {after} dB");
    let list = |run: &str| run_json(root, &["segment", "list", run])["segments"].clone();
    assert_eq!(list("small"), list("run"));
    let track = run_json(root, &["track", "small", "--segment", &name, "--frames", "2"]);
    assert_eq!(track[0]["statistics"].as_array().unwrap().len(), 2);
    assert!(std::fs::read_to_string(root.join("small/edits.json")).unwrap().contains("recolour"));
    let render = ["render", "small", "--camera", "0,-4,0", "--time", "0.5", "--size", "32", "--out", "still"];
    volseggs().current_dir(root).args(render).assert().success();

    // packed again, the bytes are the same; a packed run can be packed too
    let scene = |run: &str| std::fs::read(newest_scene(&root.join(run)).unwrap()).unwrap();
    run_json(root, &["pack", "run", "--out", "again"]);
    run_json(root, &["pack", "run", "--out", "again"]);
    assert!(scene("small") == scene("again"), "not the same bytes");
    run_json(root, &["pack", "small", "--out", "smaller"]);
    assert_eq!((list("smaller"), bytes(root, "smaller")), (list("run"), bytes(root, "small")));

    let resume = ["train", "--resume", "small"];
    refused(
        volseggs().current_dir(root).args(resume),
        &["small", "is packed", "resume the run that it was packed from"],
    );
    assert_eq!(json(&root.join("small/run.json"))["status"], json(&root.join("run/run.json"))["status"]);
}

#[test]
fn other_folders_are_not_replaced_and_older_checkpoints_are_not_packed() {
    let made = with_segments("pack-refused", &["--clusters", "2"]);
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    copy(&made.join("run"), &root.join("run"));
    copy(&made.join("run"), &root.join("other"));
    let before = names(&root.join("other"));
    let pack = |from: &str, out: &str| {
        let mut command = volseggs();
        command.current_dir(root).args(["pack", from, "--out", out]);
        command
    };
    refused(&mut pack("run", "other"), &["other", "not replaced"]);
    refused(&mut pack("run", "run"), &["run"]);
    assert_eq!(names(&root.join("other")), before);
    let older = checkpoints(&root.join("run"));
    let older = older.first().unwrap().1.file_name().unwrap().to_string_lossy().into_owned();
    refused(&mut pack(&format!("run/checkpoints/{older}"), "small"), &["an older checkpoint", "run"]);
    refused(&mut pack("nowhere", "small"), &["nowhere"]);
    assert!(!root.join("small").exists());
}
