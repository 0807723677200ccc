//! `--config static` as a whole program: one time of a dataset with many, trained without a field, evaluated and
//! rendered.

use crate::common::{dataset, json, metrics, names, refused, volseggs};
use serde_json::Value;
use std::path::Path;

/// The preset on images of 32x32, in 200 steps.
const SMALL: &[&str] = &[
    "init.points=300",
    "init.box_half_size=1.0",
    "stages.warmup_steps=200",
    "stages.sh_every=50",
    "loss.dssim_last=200",
    "optim.warmup_decay_steps=200",
    "densify.every=20",
    "densify.warmup_from=20",
    "densify.warmup_until=100",
    "densify.prune_every=20",
    "densify.budget=500",
    "densify.opacity_reset=60",
    "densify.opacity_reset_until=60",
    "output.checkpoint_every=100",
    "output.eval_every=100",
    "output.log_every=10",
];

fn train(root: &Path, name: &str, more: &[&str]) -> assert_cmd::Command {
    let mut command = volseggs();
    command.args(["train", "--config", "static", "--data"]).arg(root.join("data")).arg("--out").arg(root.join(name));
    for set in SMALL.iter().chain(more) {
        command.args(["--set", set]);
    }
    command
}

#[test]
fn one_time_of_several_is_trained_evaluated_and_rendered() {
    let root = dataset();
    let run = root.path().join("run");
    let output = train(root.path(), "run", &["data.only_times=[0.3]"]).assert().success().get_output().clone();
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(message.contains("6 training views of 32x32 at 1 times"), "{message}");
    let record = json(&run.join("run.json"));
    assert_eq!((&record["status"], &record["steps"]), (&"complete".into(), &200.into()));
    let lines = metrics(&run);
    assert!(lines.iter().all(|l| l["stage"] == "warmup"));
    let psnr = |k: usize| lines[k]["train_psnr"].as_f64().unwrap();
    assert!(psnr(19) > psnr(0) + 3.0, "{} dB, then {} dB", psnr(0), psnr(19));

    let output = volseggs().args(["eval", "--json"]).arg(&run).assert().success().get_output().clone();
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(message.contains("data.only_times") && message.contains("0.333"), "{message}");
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["views"], 2, "the test views at that time");
    assert!(summary["psnr"].as_f64().unwrap() > 15.0, "{summary}");

    let frames = root.path().join("frames");
    volseggs()
        .arg("render")
        .arg(&run)
        .args(["--path", "orbit", "--frames", "3", "--out"])
        .arg(&frames)
        .assert()
        .success();
    assert!(names(&frames).iter().filter(|n| n.ends_with(".png")).count() >= 3);
}

#[test]
fn invalid_times_are_refused_by_key() {
    let root = dataset();
    let cases: [(&str, &[&str]); 3] = [
        ("data.only_times=[0.3,0.35]", &["data.only_times", "0.3 and 0.35 both choose the training time 0.333"]),
        ("data.only_times=[1.5]", &["data.only_times: 1.5", "between 0 and 1"]),
        ("data.times=2", &["data.only_times", "data.times = 2", "one of them"]),
    ];
    for (set, words) in cases {
        refused(&mut train(root.path(), "run", &[set]), words);
        assert!(!root.path().join("run").exists());
    }
}
