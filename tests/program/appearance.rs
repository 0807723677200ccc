//! `model.appearance = "headlight"` as a whole program: trained, evaluated, relit, exported, and segmented by base
//! colours.

use crate::common::{json, refused, text, train, volseggs};
use std::path::Path;
use volseggs::export::ply;

fn still(root: &Path, run: &str, out: &str, more: &[&str]) -> assert_cmd::Command {
    let mut command = volseggs();
    command.args(["render", &text(root, run), "--camera", "3,-2,-1.5", "--time", "0.25", "--size", "24"]);
    command.args(["--out", &text(root, out)]).args(more);
    command
}

#[test]
fn a_shaded_scene_works_with_every_command() {
    let folder = crate::common::dataset();
    let root = folder.path();
    train(root, "run", &["model.appearance=headlight"]).assert().success();
    let run = text(root, "run");
    let output = volseggs().args(["eval", &run, "--json"]).assert().success().get_output().clone();
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(summary["psnr"].as_f64().unwrap() > 15.0, "{summary}");

    still(root, "run", "eye", &[]).assert().success();
    still(root, "run", "side", &["--light", "0,0,1"]).assert().success();
    let picture = |out: &str| std::fs::read(root.join(out).join("0000.png")).unwrap();
    assert_ne!(picture("eye"), picture("side"));
    assert_eq!(json(&root.join("side/frames.json"))["light"], serde_json::json!([0.0, 0.0, 1.0]));
    refused(&mut still(root, "run", "no", &["--light", "0,0,0"]), &["--light", "not a direction"]);
    refused(&mut still(root, "run", "no", &["--light", "0,0,1", "--show", "depth"]), &["--light", "--show"]);

    let file = root.join("scene.ply");
    volseggs().args(["export", &run, "--time", "0.5", "--out"]).arg(&file).assert().success();
    let read = ply::read(&file).unwrap();
    assert_eq!((read.len(), read.sh_degree(), read.shading.is_none()), (400, 3, true));

    volseggs().args(["segment", "coarse", &run, "--clusters", "2"]).assert().success();
}

#[test]
fn a_light_is_refused_for_spherical_harmonics() {
    let folder = crate::common::dataset();
    train(folder.path(), "run", &[]).assert().success();
    let words = ["--light", "model.appearance = \"sh\"", "headlight"];
    refused(&mut still(folder.path(), "run", "no", &["--light", "0,0,1"]), &words);
    assert!(!folder.path().join("no").exists());
}
