//! `volseggs train` as a whole program: what a run leaves, determinism, interruption and resumption.

use crate::common::{BINARY, dataset, json, metrics, names, newest_bytes, refused, train, train_arguments};
use serde_json::Value;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use volseggs::device::DeviceName;
use volseggs::model::Scene;
use volseggs::model::scene_file::read_tensors;
use volseggs::train::checkpoint::{self, CheckpointState};

#[test]
fn a_run_leaves_a_complete_folder() {
    let root = dataset();
    let run = root.path().join("run");
    let output = train(root.path(), "run", &[]).arg("--json").assert().success().get_output().clone();
    let printed: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(output.stderr.starts_with(b"no --config: preset best\n"), "{}", String::from_utf8_lossy(&output.stderr));

    assert_eq!(names(&run), [".lock", "checkpoints", "config.toml", "metrics.jsonl", "run.json", "tensorboard"]);
    assert_eq!(names(&run.join("checkpoints")), ["step-000070", "step-000080"]);
    let files = names(&run.join("checkpoints/step-000080"));
    assert_eq!(files, ["optimizer.safetensors", "scene.safetensors", "state.json"]);
    let events = names(&run.join("tensorboard"));
    assert!(events.len() == 1 && events[0].starts_with("events.out.tfevents."), "{events:?}");
    let events = std::fs::read(run.join("tensorboard").join(&events[0])).unwrap();
    for tag in ["train/loss", "train/psnr", "train/gaussians", "test/psnr"] {
        assert!(events.windows(tag.len()).any(|w| w == tag.as_bytes()), "{tag}");
    }

    let record = json(&run.join("run.json"));
    assert_eq!(record, printed);
    assert_eq!((&record["status"], &record["steps"]), (&"complete".into(), &80.into()));
    assert_eq!((&record["gaussians"], &record["device"]), (&400.into(), &"flex".into()));
    assert!(record["training_seconds"].as_f64().unwrap() > 0.0);
    let config: toml::Table = std::fs::read_to_string(run.join("config.toml")).unwrap().parse().unwrap();
    assert_eq!(config["densify"]["budget"].as_integer(), Some(400));
    assert_eq!(config["optim"]["betas"].as_array().map(Vec::len), Some(2));

    let lines = metrics(&run);
    let steps: Vec<u64> = lines.iter().map(|l| l["step"].as_u64().unwrap()).collect();
    assert_eq!(steps, [10, 20, 30, 40, 50, 60, 70, 80]);
    let stages: Vec<&str> = lines.iter().map(|l| l["stage"].as_str().unwrap()).collect();
    assert_eq!((stages[1], stages[2]), ("warmup", "joint"));
    let tested: Vec<bool> = lines.iter().map(|l| l.get("test_psnr").is_some()).collect();
    assert_eq!(tested, [false, false, false, true, false, false, false, true]);

    // the budget is reached exactly, and never exceeded on the way
    let counts: Vec<u64> = lines.iter().map(|l| l["gaussians"].as_u64().unwrap()).collect();
    assert!(counts.is_sorted() && counts[0] == 300 && counts[1] > 300 && counts[7] == 400, "{counts:?}");
    let device = DeviceName::Flex.open().unwrap();
    let scene = Scene::load(&run.join("checkpoints/step-000080/scene.safetensors"), &device).unwrap();
    assert_eq!(scene.gaussians.count(), 400);
}

#[test]
fn training_improves_the_images() {
    let root = dataset();
    let length = ["stages.joint_steps=280", "densify.joint_until=200", "output.eval_views=6", "output.eval_every=10"];
    // the default rates are meant for thousands of steps
    let rates = ["optim.encoder=0.05", "optim.decoder=0.01", "optim.final_fraction=0.3"];
    let more: Vec<&str> = length.into_iter().chain(rates).collect();
    train(root.path(), "run", &more).assert().success();
    let lines = metrics(&root.path().join("run"));
    let mean = |key: &str, from: usize, to: usize| {
        lines[from..to].iter().map(|l| l[key].as_f64().unwrap()).sum::<f64>() / (to - from) as f64
    };
    let (first, last) = (mean("train_psnr", 0, 2), mean("train_psnr", lines.len() - 5, lines.len()));
    assert!(last > 23.0 && last > first + 5.0, "training views: {first} dB, then {last} dB");
    let (first, last) = (mean("test_psnr", 0, 1), mean("test_psnr", lines.len() - 1, lines.len()));
    assert!(last > 22.0 && last > first + 5.0, "test views: {first} dB, then {last} dB");
}

#[test]
fn the_same_seed_gives_the_same_bytes_for_any_number_of_threads() {
    let root = dataset();
    let bytes = |name: &str, threads: &str, more: &[&str]| {
        train(root.path(), name, more).env("RAYON_NUM_THREADS", threads).assert().success();
        newest_bytes(&root.path().join(name))
    };
    let one = bytes("one", "1", &[]);
    assert!(bytes("two", "2", &[]) == one, "two threads give a different result from one");
    assert!(bytes("four", "4", &[]) == one, "four threads give a different result from one");
    assert!(bytes("again", "4", &[]) == one, "two identical runs differ");
    let other = bytes("other", "2", &["seed=1"]);
    assert!(other.0 != one.0 && other.1 != one.1, "another seed gives the same result");
}

#[test]
fn a_stopped_and_resumed_run_equals_an_uninterrupted_one() {
    let root = dataset();
    let (whole, parts) = (root.path().join("whole"), root.path().join("parts"));
    train(root.path(), "whole", &[]).assert().success();
    train(root.path(), "parts", &[]).args(["--stop-after", "37"]).assert().success();
    let record = json(&parts.join("run.json"));
    assert_eq!((&record["status"], &record["steps"]), (&"interrupted".into(), &37.into()));
    assert_eq!(names(&parts.join("checkpoints")), ["step-000030", "step-000037"]);
    train(root.path(), "parts", &[]).args(["--resume", "--stop-after", "20"]).assert().success();
    assert_eq!(json(&parts.join("run.json"))["steps"], 37, "a limit already passed undoes no steps");

    train(root.path(), "parts", &[]).arg("--resume").assert().success();
    assert!(newest_bytes(&parts) == newest_bytes(&whole), "the resumed run has a different result");
    assert_eq!(metrics(&parts), metrics(&whole));
    let record = json(&parts.join("run.json"));
    assert_eq!((&record["status"], &record["steps"]), (&"complete".into(), &80.into()));

    // resuming with nothing left to do changes nothing, not even who trained it
    let (path, mut before) = (parts.join("run.json"), record);
    (before["device"], before["build"]) = ("wgpu".into(), "abc".into());
    std::fs::write(&path, before.to_string()).unwrap();
    train(root.path(), "parts", &[]).arg("--resume").assert().success();
    assert!(newest_bytes(&parts) == newest_bytes(&whole));
    assert_eq!(metrics(&parts), metrics(&whole));
    assert_eq!(json(&path), before);
}

#[test]
fn a_resumed_run_with_every_speed_setting_equals_an_uninterrupted_one() {
    let root = dataset();
    let savings = ["speed.coarse_steps=40", "speed.sort_every=25", "speed.cull_visits=4"];
    // many start where there is nothing, and fade quickly
    let fading = ["init.placement=box", "init.opacity=0.01", "optim.opacity=0.5", "densify.prune_opacity=0"];
    let fixed = ["densify.mode=off", "densify.budget=300"];
    let more: Vec<&str> = savings.into_iter().chain(fixed).chain(fading).collect();
    train(root.path(), "whole", &more).assert().success();
    train(root.path(), "parts", &more).args(["--stop-after", "33"]).assert().success();
    train(root.path(), "parts", &more).args(["--resume", "--stop-after", "69"]).assert().success();
    let parts = root.path().join("parts");
    let (tensors, _) = read_tensors(&parts.join("checkpoints/step-000069/optimizer.safetensors")).unwrap();
    let culled = tensors.iter().filter(|(name, _)| name.starts_with("culled."));
    assert!(culled.flat_map(|(_, t)| &t.values[1..]).any(|v| *v > 0.0), "no Gaussian is culled, so nothing is tested");
    train(root.path(), "parts", &more).arg("--resume").assert().success();
    assert!(newest_bytes(&parts) == newest_bytes(&root.path().join("whole")), "the resumed run has a different result");
}

fn spawn(root: &Path, name: &str, more: &[&str]) -> Child {
    let mut command = Command::new(BINARY);
    command.args(train_arguments(root, name, more));
    if !checkpoint::list(&root.join(name)).is_empty() {
        command.arg("--resume");
    }
    command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Checks that the newest checkpoint, from which a resumed run starts, can be used, and that nothing with a temporary
/// name counts as one. Returns the number of checkpoints.
fn check_checkpoints(run: &Path) -> usize {
    if !run.join("checkpoints").exists() {
        return 0;
    }
    let (named, other): (Vec<String>, Vec<String>) =
        names(&run.join("checkpoints")).into_iter().partition(|n| n.starts_with("step-"));
    assert!(other.iter().all(|n| n.starts_with(".tmp-")), "{other:?}");
    let listed = checkpoint::list(run);
    let newest = listed.last().map(|(step, _)| checkpoint::folder_name(*step));
    assert_eq!(newest.as_ref(), named.last(), "{named:?} {other:?}");
    let device = DeviceName::Flex.open().unwrap();
    assert_eq!(listed.len(), named.len(), "{named:?}");
    for (step, path) in &listed {
        let state: CheckpointState = serde_json::from_value(json(&path.join("state.json"))).unwrap();
        assert_eq!(state.step, *step);
        let scene = Scene::load(&path.join("scene.safetensors"), &device).unwrap();
        let (tensors, _) = read_tensors(&path.join("optimizer.safetensors")).unwrap();
        let count = scene.gaussians.count();
        assert_eq!(tensors["statistics.views"].values.len(), count);
        assert_eq!(tensors["adam.first.gaussians.means"].values.len(), 3 * count);
    }
    listed.len()
}

#[test]
fn a_killed_run_keeps_complete_checkpoints_and_ends_the_same() {
    let root = dataset();
    let more = ["stages.joint_steps=280", "densify.joint_until=200", "output.checkpoint_every=4"];
    let started = Instant::now();
    train(root.path(), "whole", &more).assert().success();
    let whole = started.elapsed();

    let run = root.path().join("killed");
    let (mut killed, mut seen) = (0, 0);
    for share in [0.08, 0.4, 0.15, 0.31, 0.22, 0.37, 0.5] {
        let mut child = spawn(root.path(), "killed", &more);
        // scaled to the machine's speed, so that training gets somewhere even when the machine is busy
        std::thread::sleep(whole.mul_f64(share).max(Duration::from_millis(50)));
        // the last one reaches a checkpoint, however busy the machine has become since it was measured
        while share == 0.5 && checkpoint::list(&run).is_empty() && child.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(2));
        }
        let running = child.try_wait().unwrap().is_none();
        child.kill().unwrap();
        child.wait().unwrap();
        killed += usize::from(running);
        seen += check_checkpoints(&run);
    }
    assert!(killed >= 3 && seen > 0, "{killed} runs killed, {seen} checkpoints seen");

    train(root.path(), "killed", &more).arg("--resume").assert().success();
    check_checkpoints(&run);
    for folder in [run.clone(), run.join("checkpoints")] {
        assert!(names(&folder).iter().all(|n| !n.starts_with(".tmp-")), "temporaries are left in {}", folder.display());
    }
    assert!(newest_bytes(&run) == newest_bytes(&root.path().join("whole")), "the killed run has a different result");
    assert_eq!(metrics(&run), metrics(&root.path().join("whole")));
    assert_eq!(json(&run.join("run.json"))["status"], "complete");
}

#[cfg(unix)]
#[test]
fn signals_save_a_checkpoint() {
    let root = dataset();
    // far too long to end by itself, with no checkpoint due before the signal comes
    let more = ["stages.joint_steps=200000", "output.checkpoint_every=100000"];
    for signal in ["TERM", "INT"] {
        let run = root.path().join(signal);
        let child = spawn(root.path(), signal, &more);
        let started = Instant::now();
        let lines = || std::fs::read_to_string(run.join("metrics.jsonl")).map_or(0, |t| t.lines().count());
        while lines() < 2 {
            assert!(started.elapsed() < Duration::from_secs(60), "no step taken");
            std::thread::sleep(Duration::from_millis(10));
        }
        let sent = Command::new("kill").args(["-s", signal, &child.id().to_string()]).status().unwrap();
        assert!(sent.success());
        let output = child.wait_with_output().unwrap();
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{text}");
        assert!(
            text.contains("with a checkpoint")
                && text.contains(&format!("next: volseggs train --resume {}", run.display())),
            "{text}"
        );

        let record = json(&run.join("run.json"));
        assert_eq!(record["status"], "interrupted");
        let steps = record["steps"].as_u64().unwrap();
        assert!(steps >= 20);
        assert_eq!(names(&run.join("checkpoints")), [checkpoint::folder_name(steps as usize)]);
        assert_eq!(check_checkpoints(&run), 1);
        let next = (steps + 3).to_string();
        train(root.path(), signal, &more).args(["--resume", "--stop-after", &next]).assert().success();
        assert_eq!(json(&run.join("run.json"))["steps"], steps + 3);
    }
}

#[test]
fn a_run_is_neither_overwritten_nor_resumed_with_other_settings() {
    let root = dataset();
    train(root.path(), "run", &[]).args(["--stop-after", "12"]).assert().success();
    let run = root.path().join("run");
    let before = (newest_bytes(&run), std::fs::read(run.join("config.toml")).unwrap(), metrics(&run));
    let unchanged = || (newest_bytes(&run), std::fs::read(run.join("config.toml")).unwrap(), metrics(&run));

    refused(&mut train(root.path(), "run", &[]), &["run", "checkpoints of a run", "--resume", "--out"]);
    assert!(unchanged() == before);
    let mut changed = train(root.path(), "run", &["loss.dssim=0.1"]);
    refused(changed.arg("--resume"), &["step-000012", "loss.dssim was 0.05 and is 0.1 now", "12 steps already taken"]);
    assert!(unchanged() == before);
    let json = root.path().join("data/transforms_train.json");
    let text = std::fs::read_to_string(&json).unwrap();
    std::fs::write(&json, format!("{text}\n")).unwrap();
    refused(train(root.path(), "run", &[]).arg("--resume"), &["step-000012", "another dataset"]);
    assert!(unchanged() == before);
}
