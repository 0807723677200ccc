//! Long work from a window: it makes what the commands make, is announced to every window, and can be cancelled.

use crate::common::{copy, run_json, volseggs};
use crate::run;
use crate::socket::{Server, Window};
use serde_json::{Value, json};
use std::path::Path;

fn start(window: &mut Window, id: u32, task: &Value) {
    let base = window.document["revision"].clone();
    window.say(&json!({ "type": "job", "id": id, "base": base, "task": task }));
}

/// Runs a task and returns how it ended.
fn ended(window: &mut Window, id: u32, task: &Value) -> Value {
    start(window, id, task);
    let answer = window.wait_for(|m| m["id"] == id);
    assert_eq!(answer["type"], "done", "{answer}");
    window.wait_for(|m| m["type"] == "job" && !m["end"].is_null())
}

/// Runs a task and returns the description of its result.
fn made(window: &mut Window, id: u32, task: &Value) -> String {
    let job = ended(window, id, task);
    job["end"]["done"].as_str().unwrap_or_else(|| panic!("{job}")).to_owned()
}

#[test]
fn jobs_from_a_window_write_the_same_files_as_commands() {
    let folder = run();
    let root = folder.path();
    for file in ["segments/masks.jsonl", "segments/affinity.safetensors"] {
        std::fs::remove_file(root.join("run").join(file)).unwrap();
    }
    let typed = root.join("typed");
    copy(&root.join("run"), &typed.join("run"));
    let server = Server::start(root, &[]);
    let (mut window, welcome) = Window::open(&server);
    assert_eq!(welcome["clicks"], false);
    let name = window.document["segments"][0]["name"].as_str().unwrap().to_owned();
    let same = |file: &str| {
        let [viewed, typed] = [root, &typed].map(|root| std::fs::read(root.join("run").join(file)).unwrap());
        assert!(viewed == typed, "{file}: different bytes from the command's");
    };
    let command = |words: &[&str]| drop(volseggs().current_dir(&typed).args(words).assert().success());

    let masks = |replace: bool| json!({ "kind": "masks", "segments": [], "source": "regions", "views": 5, "size": 64, "replace": replace });
    assert!(made(&mut window, 1, &masks(false)).contains("in 5 views"));
    command(&["segment", "masks", "run", "--views", "5", "--size", "64"]);
    same("segments/masks.jsonl");
    same("segments/masks.png");
    let refused = ended(&mut window, 2, &masks(false));
    assert!(refused["end"]["failed"].as_str().unwrap().contains("tick `replace` beside `make masks`"), "{refused}");

    start(&mut window, 3, &json!({ "kind": "fine", "steps": 40 }));
    let able = window.wait_for(|m| m["type"] == "welcome");
    assert_eq!(able["clicks"], true, "clicks are possible from now on");
    let job = window.wait_for(|m| m["type"] == "job" && !m["end"].is_null());
    assert_eq!(
        (&job["unit"], &job["done"], job["losses"].as_array().unwrap().len()),
        (&json!("steps"), &json!(40), 40)
    );
    command(&["segment", "fine", "run", "--steps", "40"]);
    same("segments/affinity.safetensors");

    let split = json!({ "kind": "split", "segment": name, "scale": 0.5, "clusters": 2, "replace": false });
    assert!(made(&mut window, 4, &split).contains("2 parts"));
    let part = format!("{name}.1");
    assert!(
        window.document["segments"].to_string().contains(&part),
        "not announced before the end: {}",
        window.document
    );
    command(&["segment", "split", "run", &name, "--clusters", "2"]);
    let list = |root: &Path| run_json(root, &["segment", "list", "run"])["segments"].clone();
    assert_eq!(list(root), list(&typed));

    let track = json!({ "kind": "track", "segments": [part], "group": null, "frames": 5 });
    assert!(made(&mut window, 5, &track).contains("track"));
    command(&["track", "run", "--segment", &part, "--frames", "5"]);
    for file in ["statistics.json", "events.csv", "times.png"] {
        same(&format!("track/{part}/{file}"));
    }

    let export = |format: &str, time: f64| json!({ "kind": "export", "format": format, "segments": [name], "edited": true, "time": time, "frames": null });
    made(&mut window, 6, &export("ply", 0.5));
    std::fs::create_dir_all(typed.join("run/export")).unwrap();
    command(&["export", "run", "--segment", &name, "--time", "0.5", "--out", "run/export/scene.ply"]);
    same("export/scene.ply");
    let voxels = ended(&mut window, 7, &export("nrrd", 0.5));
    assert!(voxels["end"]["failed"].as_str().unwrap().contains("prepare.json"), "views alone have no voxels: {voxels}");
}

#[test]
fn a_job_is_announced_to_later_windows_locks_the_run_and_can_be_cancelled() {
    let folder = run();
    let root = folder.path();
    let field = root.join("run/segments/affinity.safetensors");
    let before = std::fs::read(&field).unwrap();
    let server = Server::start(root, &[]);
    let (mut first, _) = Window::open(&server);
    let name = first.document["segments"][0]["name"].as_str().unwrap().to_owned();
    start(&mut first, 1, &json!({ "kind": "fine", "steps": 1_000_000 }));
    let number = first.wait_for(|m| m["type"] == "job" && m["done"].as_u64() > Some(5))["number"].clone();
    drop(first);

    let (mut second, _) = Window::open(&server);
    let job = second.wait_for(|m| m["type"] == "job" && m["losses"].as_array().is_some_and(|l| l.len() > 3));
    assert_eq!((&job["number"], &job["all"], &job["end"]), (&number, &json!(1_000_000), &Value::Null));
    assert!(job["left"].as_f64().unwrap() > 0.0 && job["seconds"].as_f64().unwrap() > 0.0);
    let base = second.document["revision"].clone();
    let fade = json!({ "kind": "edit", "segments": [name], "operation": "hide" });
    second.say(&json!({ "type": "change", "id": 2, "base": base, "change": fade }));
    let refused = second.wait_for(|m| m["id"] == 2);
    assert!(refused["message"].as_str().unwrap().contains("training the affinity field"), "{refused}");
    let command = volseggs().current_dir(root).args(["segment", "remove", "run", &name]).assert().failure();
    assert!(String::from_utf8_lossy(&command.get_output().stderr).contains("in use by `volseggs view: training"));
    start(&mut second, 3, &json!({ "kind": "fine", "steps": 1 }));
    let refused = second.wait_for(|m| m["id"] == 3);
    assert!(refused["message"].as_str().unwrap().contains("is under way"), "{refused}");
    second.say(&json!({ "type": "cancel", "id": 4, "job": 99 }));
    assert_eq!(second.wait_for(|m| m["id"] == 4)["type"], "error", "another job");

    second.say(&json!({ "type": "cancel", "id": 5, "job": number }));
    assert_eq!(second.wait_for(|m| m["id"] == 5)["type"], "done");
    second.wait_for(|m| m["type"] == "job" && m["end"] == "stopped");
    assert!(std::fs::read(&field).unwrap() == before, "the previous field is kept");
    second.say(&json!({ "type": "change", "id": 6, "base": base, "change": fade }));
    assert_eq!(second.wait_for(|m| m["id"] == 6)["type"], "done", "the run is free again");
}

#[test]
fn a_failed_job_is_reported_and_a_read_only_viewer_starts_none() {
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &[]);
    let (mut window, _) = Window::open(&server);
    let split = json!({ "kind": "split", "segment": "nobody", "scale": 0.5, "clusters": null, "replace": false });
    let job = ended(&mut window, 1, &split);
    assert!(job["end"]["failed"].as_str().unwrap().contains("nobody"), "{job}");
    start(&mut window, 2, &json!({ "kind": "fine", "steps": 0 }));
    assert!(window.wait_for(|m| m["id"] == 2)["message"].as_str().unwrap().starts_with("steps: must be between 1 and"));
    window.say(&json!({ "type": "job", "id": 3, "base": 999, "task": split }));
    assert!(window.wait_for(|m| m["id"] == 3)["message"].as_str().unwrap().contains("changed meanwhile"));
    drop((window, server));

    let server = Server::start(root, &["--read-only"]);
    let (mut window, _) = Window::open(&server);
    start(&mut window, 1, &split);
    assert!(window.wait_for(|m| m["id"] == 1)["message"].as_str().unwrap().contains("--read-only"));
}
