//! Resuming a run: by its folder alone, for longer, from an older checkpoint; and what is refused.

use crate::common::{dataset, json, metrics, names, newest_bytes, refused, text, train, volseggs};
use std::path::Path;
use volseggs::model::scene_file::{read_tensors, write_tensors};
use volseggs::train::checkpoint;

/// `volseggs train --resume PATH` with more arguments.
fn resume(path: &Path, more: &[&str]) -> assert_cmd::Command {
    let mut command = volseggs();
    command.args(["train", "--resume"]).arg(path).args(more);
    command
}

#[test]
fn a_run_resumes_from_its_folder_alone_and_its_log_settings_may_change() {
    let root = dataset();
    let (whole, run) = (root.path().join("whole"), root.path().join("run"));
    train(root.path(), "whole", &[]).assert().success();
    train(root.path(), "run", &[]).args(["--stop-after", "37"]).assert().success();
    let more = ["--set", "output.log_every=5", "--set", "output.checkpoint_every=7", "--set", "output.keep=3"];
    let output = resume(&run, &more).assert().success().get_output().clone();
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(message.contains("note: output.log_every was 10 and is 5 now"), "{message}");
    assert!(newest_bytes(&run) == newest_bytes(&whole), "the resumed run has a different result");
    assert_eq!(names(&run.join("checkpoints")).len(), 3);
    let steps: Vec<u64> = metrics(&run).iter().map(|l| l["step"].as_u64().unwrap()).collect();
    assert_eq!(steps[..6], [10, 20, 30, 40, 45, 50]);
    // what was changed stays in the run's configuration
    resume(&run, &[]).assert().success();
    assert!(std::fs::read_to_string(run.join("config.toml")).unwrap().contains("keep = 3"));
}

#[test]
fn a_trained_run_can_be_lengthened_but_not_shortened_or_changed() {
    let root = dataset();
    let run = root.path().join("run");
    train(root.path(), "run", &["stages.joint_steps=30"]).assert().success();
    let before = newest_bytes(&run);
    refused(
        &mut resume(&run, &["--set", "stages.joint_steps=20"]),
        &["stages.joint_steps was 30 and is 20 now", "--stop-after"],
    );
    refused(
        &mut resume(&run, &["--set", "seed=5", "--set", "init.points=301"]),
        &["seed was 0 and is 5 now", "init.points was 300 and is 301 now", "50 steps already taken"],
    );
    assert!(newest_bytes(&run) == before);
    let output = resume(&run, &["--set", "stages.joint_steps=60"]).assert().success().get_output().clone();
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(
        message.contains("stages.joint_steps was 30 and is 60 now: rates") && message.contains("not that of a run"),
        "{message}"
    );
    let record = json(&run.join("run.json"));
    assert_eq!((&record["status"], &record["steps"]), (&"complete".into(), &80.into()));
}

#[test]
fn a_changed_key_is_named_also_where_it_changes_the_data() {
    let root = dataset();
    let run = root.path().join("run");
    train(root.path(), "run", &[]).args(["--stop-after", "12"]).assert().success();
    let more = ["--set", "data.downscale=2", "--set", "data.times=2"];
    refused(
        &mut resume(&run, &more),
        &["data.downscale was 1 and is 2 now", "data.times was 0 and is 2 now", "12 steps already taken"],
    );
    // other images under the same keys are another dataset
    let image = root.path().join("data/train/r_001.png");
    image::open(&image).unwrap().flipv().save(&image).unwrap();
    std::fs::OpenOptions::new()
        .append(true)
        .open(&image)
        .unwrap()
        .set_len(std::fs::metadata(&image).unwrap().len() + 9)
        .unwrap();
    refused(&mut resume(&run, &[]), &["another dataset", "--data"]);
}

#[test]
fn another_average_of_a_finished_run_is_its_scene() {
    let root = dataset();
    let (run, raw) = (root.path().join("run"), root.path().join("raw"));
    let more = ["stages.joint_steps=200", "densify.mode=off", "densify.budget=300"];
    train(root.path(), "run", &[&more[..], &["optim.average=20"]].concat()).assert().success();
    train(root.path(), "raw", &[&more[..], &["optim.average=0"]].concat()).assert().success();
    let scene = |run: &Path| newest_bytes(run).0;
    assert!(scene(&run) != scene(&raw), "the average has no effect, so nothing is tested");
    let output = resume(&run, &["--set", "optim.average=0"]).assert().success().get_output().clone();
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(message.contains("has changed with optim.average; evaluate it again"), "{message}");
    assert!(scene(&run) == scene(&raw), "the average is still shown");
}

#[test]
fn a_run_without_a_checkpoint_is_not_restarted() {
    let root = dataset();
    let run = root.path().join("run");
    refused(&mut resume(&run, &[]), &["run"]);
    assert!(!run.exists());
    refused(train(root.path(), "run", &[]).arg("--resume"), &["run"]);
    train(root.path(), "run", &[]).args(["--stop-after", "12"]).assert().success();
    for entry in checkpoint::list(&run) {
        std::fs::remove_file(entry.1.join("state.json")).unwrap();
    }
    refused(&mut resume(&run, &[]), &["step-000012: state.json is missing", "no older checkpoint is intact"]);
    refused(volseggs().arg("eval").arg(&run), &["step-000012: state.json is missing"]);
    std::fs::remove_dir_all(run.join("checkpoints")).unwrap();
    let metrics_before = std::fs::read(run.join("metrics.jsonl")).unwrap();
    refused(&mut resume(&run, &[]), &["no checkpoint to resume from"]);
    refused(train(root.path(), "run", &[]).arg("--resume"), &["no checkpoint to resume from"]);
    assert_eq!(std::fs::read(run.join("metrics.jsonl")).unwrap(), metrics_before);
}

#[test]
fn garbage_in_the_metrics_is_reported_once_and_changes_nothing() {
    let root = dataset();
    let run = root.path().join("run");
    train(root.path(), "run", &[]).args(["--stop-after", "12"]).assert().success();
    std::fs::write(run.join("metrics.jsonl"), "garbage\n").unwrap();
    let record = std::fs::read(run.join("run.json")).unwrap();
    let message = refused(&mut resume(&run, &[]), &["metrics.jsonl:1: not a JSON line", "remove"]);
    assert_eq!(message.matches("metrics.jsonl").count(), 1, "{message}");
    assert_eq!(std::fs::read(run.join("run.json")).unwrap(), record);
}

/// Changes a byte in the middle of a file.
fn damage(path: &Path) {
    let mut bytes = std::fs::read(path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn a_damaged_checkpoint_is_reported_and_the_older_one_suggested() {
    let root = dataset();
    let (whole, run) = (root.path().join("whole"), root.path().join("run"));
    train(root.path(), "whole", &[]).assert().success();
    train(root.path(), "run", &[]).args(["--stop-after", "37"]).assert().success();
    let (older, newest) = (run.join("checkpoints/step-000030"), run.join("checkpoints/step-000037"));
    damage(&newest.join("scene.safetensors"));
    damage(&newest.join("optimizer.safetensors"));
    let offer = format!("volseggs train --resume {}", older.display());
    refused(&mut resume(&run, &[]), &["step-000037", "damaged", "digest", "older checkpoint is intact", &offer]);
    for (command, more) in [("eval", &[][..]), ("render", &["--out", "x"]), ("export", &["--out", "x.ply"])] {
        let mut program = volseggs();
        program.current_dir(root.path()).arg(command).arg(&run).args(more);
        refused(&mut program, &["step-000037", "damaged", &format!("give {} in place of", older.display())]);
    }
    // the older one works in its place
    let mut program = volseggs();
    program.args(["export"]).arg(&older).args(["--out", &text(root.path(), "older.ply")]).assert().success();
    resume(&older, &[]).assert().success();
    assert!(newest_bytes(&run) == newest_bytes(&whole), "the run has a different result");
    assert!(
        names(&run.join("checkpoints")).contains(&"aside-step-000037".to_owned()),
        "the damaged checkpoint is kept"
    );
    assert_eq!(metrics(&run), metrics(&whole));

    // if none is complete, the message says so
    for (_, path) in checkpoint::list(&run) {
        damage(&path.join("scene.safetensors"));
    }
    refused(volseggs().arg("eval").arg(&run), &["damaged", "no older checkpoint is intact"]);
}

#[test]
fn an_incomplete_checkpoint_is_reported_and_not_skipped() {
    let root = dataset();
    let (whole, run) = (root.path().join("whole"), root.path().join("run"));
    train(root.path(), "whole", &[]).assert().success();
    train(root.path(), "run", &[]).assert().success();
    std::fs::remove_file(run.join("checkpoints/step-000080/state.json")).unwrap();
    let older = run.join("checkpoints/step-000070");
    let offer = format!("volseggs train --resume {}", older.display());
    refused(&mut resume(&run, &[]), &["step-000080: state.json is missing", &offer]);
    refused(volseggs().arg("eval").arg(&run), &["step-000080: state.json is missing"]);
    resume(&older, &[]).assert().success();
    assert!(newest_bytes(&run) == newest_bytes(&whole), "the run has a different result");
    assert!(names(&run.join("checkpoints")).contains(&"aside-step-000080".to_owned()));
    // a checkpoint that was set aside can be resumed from too, and older ones stay
    let of = |key: &str| crate::common::json(&run.join("run.json"))[key].as_f64().unwrap();
    let seconds = of("training_seconds");
    resume(&run.join("checkpoints/step-000070"), &["--stop-after", "70"]).assert().success();
    assert!(of("steps") == 70.0 && of("training_seconds") < seconds, "those of the checkpoint");
    let aside = run.join("checkpoints/aside-step-000080-1");
    resume(&aside, &[]).assert().success();
    assert!(names(&run.join("checkpoints")).contains(&"step-000070".to_owned()));
}

#[test]
fn results_of_an_older_checkpoint_are_kept_separately() {
    let root = dataset();
    let run = root.path().join("run");
    train(root.path(), "run", &[]).assert().success();
    volseggs().arg("eval").arg(&run).assert().success();
    let before = std::fs::read(run.join("eval/test/mean.json")).unwrap();
    let older = run.join("checkpoints/step-000070");
    volseggs().arg("eval").arg(&older).assert().success();
    assert_eq!(std::fs::read(run.join("eval/test/mean.json")).unwrap(), before);
    assert!(run.join("eval/test-step-000070/mean.json").exists());
    let mut coarse = volseggs();
    coarse.args(["segment", "coarse"]).arg(&older);
    refused(&mut coarse, &["older checkpoint", "belongs to the newest"]);
}

#[test]
fn invalid_run_folders_are_refused_first() {
    let root = dataset();
    std::fs::write(root.path().join("plain"), "mine").unwrap();
    refused(&mut train(root.path(), "plain", &[]), &["plain", "is not a folder"]);
    refused(&mut train(root.path(), "plain/run", &[]), &["plain", "is not a folder"]);
    refused(&mut train(root.path(), "data", &[]), &["data", "is a dataset"]);
    assert!(!root.path().join("data/.lock").exists());
    // before the first step there is nothing to resume, and the hint says what to do instead
    let output = train(root.path(), "run", &[]).args(["--stop-after", "0"]).assert().get_output().clone();
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(message.contains("next: volseggs train --data ") && message.contains("/config.toml --out "), "{message}");
}

#[test]
fn a_nan_in_a_scene_is_reported_with_tensor_and_row() {
    let root = dataset();
    let run = root.path().join("run");
    train(root.path(), "run", &[]).args(["--stop-after", "12"]).assert().success();
    let path = run.join("checkpoints/step-000012/scene.safetensors");
    let (mut tensors, header) = read_tensors(&path).unwrap();
    for (value, word) in [(f32::NAN, "NaN"), (f32::INFINITY, "inf")] {
        tensors.get_mut("gaussians.means").unwrap().values[3 * 7 + 1] = value;
        write_tensors(&path, &tensors, Some(("volseggs", header["volseggs"].clone()))).unwrap();
        let mut inspect = volseggs();
        let shown = inspect.arg("inspect").arg(&run).assert().code(2).get_output().clone();
        let shown = String::from_utf8(shown.stderr).unwrap();
        assert!(shown.contains("gaussians.means, row 7") && shown.contains(word), "{shown}");
        for command in ["render", "export", "eval"] {
            let mut program = volseggs();
            program.current_dir(root.path()).arg(command).arg(&run);
            if ["render", "export"].contains(&command) {
                program.args(["--out", "out.ply"]);
            }
            refused(&mut program, &["scene.safetensors", "gaussians.means, row 7", word]);
        }
        refused(&mut resume(&run, &[]), &["gaussians.means, row 7"]);
    }
}

#[test]
fn a_folder_without_a_run_keeps_its_files() {
    let root = dataset();
    let run = root.path().join("run");
    std::fs::create_dir(&run).unwrap();
    std::fs::write(run.join("config.toml"), "mine").unwrap();
    refused(&mut train(root.path(), "run", &[]), &["config.toml", "belongs to no run"]);
    assert_eq!(std::fs::read_to_string(run.join("config.toml")).unwrap(), "mine");
    std::fs::remove_file(run.join("config.toml")).unwrap();
    std::fs::write(run.join("notes.txt"), "mine").unwrap();
    train(root.path(), "run", &[]).args(["--stop-after", "3"]).assert().success();
    assert_eq!(std::fs::read_to_string(run.join("notes.txt")).unwrap(), "mine");
}
