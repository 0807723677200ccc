//! Files of another version of the program, which are refused by name.

use crate::common::{names, refused, run_json, train, volseggs};
use assert_cmd::Command;
use std::path::{Path, PathBuf};
use volseggs::tensors::sign;

/// Returns the program in `root` with space-separated arguments.
fn call(root: &Path, arguments: &str) -> Command {
    let mut command = volseggs();
    command.current_dir(root).args(arguments.split_whitespace());
    command
}

/// Returns `bytes` with the first of `from` replaced by `to`, as long as it.
fn replaced(bytes: &[u8], from: &str, to: &str) -> Option<Vec<u8>> {
    let at = bytes.windows(from.len()).position(|part| part == from.as_bytes())?;
    let mut bytes = bytes.to_vec();
    bytes[at..at + from.len()].copy_from_slice(to.as_bytes());
    Some(bytes)
}

/// Returns a file of version 2 and one without a version. The version is under `key`, in JSON or in the header of tensors.
fn others(good: &[u8], key: &str) -> [Vec<u8>; 2] {
    let texts = [format!("\"{key}\": 1"), format!("\"{key}\":1"), format!("\\\"{key}\\\":1")];
    let text = texts.iter().find(|text| replaced(good, text, text).is_some()).unwrap();
    [text.replace('1', "2"), text.replace(key, &key.to_uppercase())].map(|other| {
        let mut bytes = replaced(good, text, &other).unwrap();
        // only tensor files have a digest
        let _ = sign(&mut bytes);
        bytes
    })
}

/// The only entry of a folder whose name starts with `start`.
fn entry(root: &Path, folder: &str, start: &str) -> PathBuf {
    let name = names(&root.join(folder)).into_iter().find(|name| name.starts_with(start)).unwrap();
    Path::new(folder).join(name)
}

#[test]
fn a_file_of_another_version_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let few = "prepare --synthetic jets --dims 24 --series-steps 3 --size 32 --times 2 --views 6 --test-views 3 \
               --segment-views 2 --out data";
    call(root, few).assert().success();
    train(root, "run", &["output.checkpoint_every=80"]).assert().success();
    call(root, "eval run").assert().success();
    run_json(root, &["segment", "coarse", "run", "--clusters", "2"]);
    let name = run_json(root, &["segment", "list", "run"])["segments"][0]["name"].as_str().unwrap().to_owned();
    call(root, "segment masks run --views 3 --size 32").assert().success();
    call(root, "segment masks run --views 2 --size 32 --pictures").assert().success();
    call(root, "segment fine run --steps 2 --pixels 64").assert().success();
    call(root, &format!("edit hide run --segment {name}")).assert().success();
    let sweep = "config = 'demo'\n[data]\njets = 'data'\n[set]\nstages.warmup_steps = 2\nstages.joint_steps = 2\n\
                 init.points = 100\ndensify.budget = 100\n";
    std::fs::write(root.join("s.toml"), sweep).unwrap();
    call(root, "sweep s.toml --out out").assert().success();

    let checkpoint = entry(root, "run/checkpoints", "step-");
    let volume = entry(root, "data/volumes", "");
    let split = format!("segment split run {name} --scale 0.5");
    let cases = [
        ("run/run.json".into(), "eval run"),
        (checkpoint.join("state.json"), "train --resume run"),
        (checkpoint.join("scene.safetensors"), "eval run"),
        ("run/eval/test/mean.json".into(), "compare run"),
        ("run/segments/segments.safetensors".into(), "segment list run"),
        ("run/segments/affinity.safetensors".into(), &split),
        (
            "run/segments/pictures/pictures.json".into(),
            "segment masks run --source dir --masks run/segments/pictures --replace",
        ),
        ("run/edits.json".into(), "edit list run"),
        ("data/prepare.json".into(), "train --data data --out other"),
        ("data/segments.json".into(), "segment masks run --source labels --replace"),
        (volume, "eval run --segments --methods coarse --no-oracle"),
        ("out/s/plan.json".into(), "sweep status s --out out"),
    ];
    for (file, command) in cases {
        let path = root.join(&file);
        let good = std::fs::read(&path).unwrap();
        let name = file.file_name().unwrap().to_str().unwrap();
        for (bytes, found) in others(&good, "format").iter().zip(["is 2", "is missing"]) {
            std::fs::write(&path, bytes).unwrap();
            refused(&mut call(root, command), &[name, "format", found, "but this program reads 1", "make it again"]);
        }
        std::fs::write(&path, good).unwrap();
    }
    // the first line of masks has `format` for what it is, and a version beside it
    let masks = root.join("run/segments/masks.jsonl");
    let good = std::fs::read(&masks).unwrap();
    std::fs::write(&masks, &others(&good, "version")[0]).unwrap();
    refused(&mut call(root, "segment fine run"), &["masks.jsonl", "version", "is 2, but this program reads 1"]);
    std::fs::write(&masks, good).unwrap();
    // what was measured by another version is not measured again over it
    let metrics = entry(root, &entry(root, "out/runs", "").display().to_string(), "metrics-");
    let good = std::fs::read(root.join(&metrics)).unwrap();
    std::fs::write(root.join(&metrics), &others(&good, "format")[0]).unwrap();
    let status = call(root, "sweep status s --out out").assert().get_output().stdout.clone();
    let status = String::from_utf8(status).unwrap();
    let name = metrics.file_name().unwrap().to_str().unwrap();
    assert!(status.contains(name) && status.contains("is 2, but this program reads 1"), "{status}");

    // the configuration in a run states every key instead
    let config = root.join("run/config.toml");
    let text = std::fs::read_to_string(&config).unwrap();
    let without: String = text.lines().filter(|line| !line.starts_with("dilation")).map(|l| format!("{l}\n")).collect();
    assert_ne!(without, text);
    std::fs::write(&config, without).unwrap();
    for command in ["eval run", "train --resume run"] {
        refused(&mut call(root, command), &["config.toml", "`model.dilation`", "states every key"]);
    }
}
