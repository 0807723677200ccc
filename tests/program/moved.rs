//! Runs and datasets that are moved together or alone, and runs without the state of their optimiser.

use crate::common::{copy, json, refused, text, train, volseggs, with_segments};
use assert_cmd::Command;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use tempfile::TempDir;

/// A folder with a dataset, a run and its segments, made once; nothing writes into it.
fn made_once() -> &'static Path {
    static ROOT: OnceLock<PathBuf> = OnceLock::new();
    ROOT.get_or_init(|| with_segments("moved", &["--clusters", "2"]))
}

/// A folder `project` with copies of both, whose record names the dataset there.
fn project() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["data", "run"] {
        copy(&made_once().join(name), &folder.path().join("project").join(name));
    }
    call(folder.path(), "relocate project/run --data project/data").assert().success();
    folder
}

/// Returns the program in `root` with space-separated arguments.
fn call(root: &Path, arguments: &str) -> Command {
    let mut command = volseggs();
    command.current_dir(root).args(arguments.split_whitespace());
    command
}

/// The files that depend on what the run knows of its dataset, made from the run at `run`, in `out`.
fn made(root: &Path, run: &str, out: &str, more: &str) -> Vec<Vec<u8>> {
    for (i, command) in [
        format!("render {run} --path orbit --frames 2 {more} --out {out}-orbit"),
        format!("render {run} --path test --size 8 {more} --out {out}-test"),
        format!("export {run} --refit 8 {more} --out {out}.ply"),
    ]
    .iter()
    .enumerate()
    {
        let said = call(root, command).assert().success().get_output().stderr.clone();
        let said = String::from_utf8(said).unwrap();
        assert!(!said.contains("note: ") || i == 2, "{command}: {said}");
    }
    let files = [format!("{out}-orbit/0001.png"), format!("{out}-test/0090.png"), format!("{out}.ply")];
    files.iter().map(|file| std::fs::read(root.join(file)).unwrap()).collect()
}

#[test]
fn a_run_and_its_dataset_that_are_moved_together_give_the_same_files() {
    let folder = project();
    let root = folder.path();
    let view = |run: &str, out: &str| {
        call(root, &format!("render {run} --view 2 --out {out}")).assert().success();
        std::fs::read(root.join(out).join("0000.png")).unwrap()
    };
    let before = (made(root, "project/run", "before", ""), view("project/run", "before-view"));
    std::fs::rename(root.join("project"), root.join("elsewhere")).unwrap();
    assert!((made(root, "elsewhere/run", "after", ""), view("elsewhere/run", "after-view")) == before);
    call(root, "eval elsewhere/run --views 2").assert().success();
    assert!(root.join("elsewhere/run/eval/test/mean.json").exists(), "it is the run's own dataset");
    call(root, "train --resume elsewhere/run").assert().success();
    let record = json(&root.join("elsewhere/run/run.json"));
    assert_eq!(record["dataset"], text(&root.canonicalize().unwrap(), "elsewhere/data"));
}

#[test]
fn a_run_alone_keeps_its_cameras_and_refuses_what_needs_the_dataset() {
    let folder = project();
    let root = folder.path();
    let before = made(root, "project/run", "before", "");
    let name = json(&root.join("project/run/run.json"))["dataset"].as_str().unwrap().to_owned();
    std::fs::rename(root.join("project/data"), root.join("data")).unwrap();
    assert!(made(root, "project/run", "after", "") == before, "size, lens and distance of the cameras are recorded");
    call(root, "track project/run --segment red --frames 2").assert().success();
    call(root, "segment masks project/run --views 2").assert().success();

    let words = [name.as_str(), "no longer there", "nor at", "--data", "volseggs relocate"];
    for command in [
        "render project/run --view 2 --out no",
        "segment pick project/run --view 2 --pixel 9,9",
        "track project/run --segment red --frames 2 --view 2",
        "export project/run --format nrrd --dims 8,8,8 --out no.nrrd",
        "segment masks project/run --source labels --replace",
        "eval project/run",
        "train --resume project/run",
    ] {
        refused(&mut call(root, command), &words);
    }
    assert!(!root.join("no").exists() && !root.join("no.nrrd").exists());
    let seen = |more: &str, out: &str| {
        call(root, &format!("render project/run --view 2 --out {out} {more}")).assert().success();
        std::fs::read(root.join(out).join("0000.png")).unwrap()
    };
    let given = seen("--data data", "given");
    call(root, "segment pick project/run --view 2 --pixel 16,16 --data data").assert().success();
    call(root, "track project/run --segment red --frames 2 --view 2 --data data").assert().success();

    // another dataset is refused, and nothing is recorded
    copy(&root.join("data"), &root.join("other"));
    let cameras = root.join("other/transforms_train.json");
    std::fs::write(&cameras, std::fs::read_to_string(&cameras).unwrap() + "\n").unwrap();
    let record = std::fs::read(root.join("project/run/run.json")).unwrap();
    for command in ["render project/run --view 2 --out no --data other", "relocate project/run --data other"] {
        refused(&mut call(root, command), &["other", "not those that", "was trained on"]);
    }
    refused(&mut call(root, "relocate project/run --data nowhere"), &["--data nowhere", "no such folder"]);
    assert_eq!(std::fs::read(root.join("project/run/run.json")).unwrap(), record);

    call(root, "relocate project/run --data data").assert().success();
    assert_eq!(seen("", "found"), given);
    // another dataset where it should have been moved to is not taken for it
    std::fs::create_dir(root.join("new")).unwrap();
    std::fs::rename(root.join("project"), root.join("new/project")).unwrap();
    std::fs::rename(root.join("other"), root.join("new/data")).unwrap();
    std::fs::rename(root.join("data"), root.join("kept")).unwrap();
    refused(&mut call(root, "render new/project/run --view 2 --out no"), &["new/data", "not those that"]);
}

#[test]
fn a_packed_run_finds_the_dataset_from_its_own_place() {
    let folder = project();
    let root = folder.path();
    std::fs::create_dir(root.join("project/small")).unwrap();
    call(root, "pack project/run --out project/small/packed").assert().success();
    std::fs::rename(root.join("project"), root.join("elsewhere")).unwrap();
    call(root, "render elsewhere/small/packed --view 2 --out view").assert().success();
}

#[test]
fn without_the_state_of_the_optimiser_only_training_is_refused() {
    let folder = project();
    let root = folder.path();
    let checkpoints = root.join("project/run/checkpoints");
    let whole = std::fs::read_dir(&checkpoints).unwrap().count();
    for checkpoint in std::fs::read_dir(&checkpoints).unwrap() {
        std::fs::remove_file(checkpoint.unwrap().path().join("optimizer.safetensors")).unwrap();
    }
    assert!(whole > 0);
    for command in [
        "segment list project/run",
        "edit list project/run",
        "edit hide project/run --segment red",
        "render project/run --path orbit --frames 1 --size 8 --out frames",
        "export project/run --refit 0 --out scene.ply",
        "pack project/run --out packed",
        "track project/run --segment red --frames 2",
        "eval project/run --views 1",
    ] {
        call(root, command).assert().success();
    }
    refused(
        &mut call(root, "train --resume project/run"),
        &["optimizer.safetensors", "is missing", "not trained further", "restore the file"],
    );
}

#[test]
fn a_dataset_that_was_calibrated_passes_that_on_to_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    crate::common::write_dataset(&root.join("data"));
    let known = serde_json::json!({
        "space": { "centre": [1000.0, -5.0, 3.5], "scale": 72.0, "unit": "mm" },
        "time": { "start": 100.0, "end": 300.0, "unit": "s" },
    });
    std::fs::write(root.join("data/prepare.json"), "{").unwrap();
    refused(&mut train(root, "run", &[]), &["prepare.json", "line 1"]);
    assert!(!root.join("run/run.json").exists());
    std::fs::write(
        root.join("data/prepare.json"),
        serde_json::json!({ "format": 1, "calibration": known }).to_string(),
    )
    .unwrap();
    train(root, "run", &[]).args(["--stop-after", "20"]).assert().success();
    let calibration = || json(&root.join("run/run.json"))["calibration"].take();
    assert_eq!(calibration(), known);
    // what the dataset says by then is taken when resuming, also by a run that takes no further step
    std::fs::write(root.join("data/prepare.json"), "{\"format\": 1, \"calibration\": {}}").unwrap();
    let mut resume = call(root, "train --resume run --stop-after 20");
    resume.assert().success();
    assert_eq!(calibration(), Value::Object(serde_json::Map::new()));
}
