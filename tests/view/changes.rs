//! Concurrent changes of the document, by windows and commands: nothing is lost.

use crate::common::{BINARY, run_json, volseggs};
use crate::socket::{Server, Window};
use crate::{list, run, setting, view};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::process::{Command, Stdio};

/// Windows that make changes at once, alongside a sequence of commands.
const WINDOWS: u64 = 3;

#[test]
fn simultaneous_changes_by_windows_and_commands_are_all_kept() {
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &[]);
    let (first, _) = Window::open(&server);
    let name = first.document["segments"][0]["name"].as_str().unwrap().to_owned();
    drop(first);
    let count = setting("VOLSEGGS_VIEW_CHANGES", 60);
    let factor = |k: u64| 0.5 + k as f64 / 4096.0;
    std::thread::scope(|scope| {
        for lane in 0..WINDOWS {
            let (server, name) = (&server, &name);
            scope.spawn(move || {
                let (mut window, _) = Window::open(server);
                for k in (lane..count).step_by(WINDOWS as usize + 1) {
                    let operation = json!({ "opacity": { "factor": factor(k) } });
                    let change = json!({ "kind": "edit", "segments": [name], "operation": operation });
                    for id in 1.. {
                        let base = window.document["revision"].clone();
                        window.say(&json!({ "type": "change", "id": id, "base": base, "change": change }));
                        let answer = window.wait_for(|m| m["id"] == id && m["type"] != "document");
                        if answer["type"] == "done" {
                            break;
                        }
                        let why = answer["message"].as_str().unwrap();
                        assert!(why.contains("changed meanwhile") || why.contains("is in use"), "{why}");
                    }
                }
            });
        }
        let name = &name;
        scope.spawn(move || {
            for k in (WINDOWS..count).step_by(WINDOWS as usize + 1) {
                let mut command = Command::new(BINARY);
                let factor = factor(k).to_string();
                let words = ["edit", "opacity", "run", "--segment", name, "--factor", &factor];
                let done = command
                    .current_dir(root)
                    .args(words)
                    .stdout(Stdio::null())
                    .stderr(Stdio::piped())
                    .output()
                    .unwrap();
                assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
            }
        });
    });
    let made = run_json(root, &["edit", "list", "run"])["operations"].as_array().unwrap().clone();
    let number =
        |o: &serde_json::Value| (4096.0 * (o["operation"]["opacity"]["factor"].as_f64().unwrap() - 0.5)).round() as u64;
    let factors: BTreeSet<u64> = made.iter().map(number).collect();
    assert_eq!((made.len() as u64, factors), (count, (0..count).collect()), "each once");
    // and the viewer knows all of them
    let (mut window, _) = Window::open(&server);
    window.wait_for(|m| m["edits"].as_array().is_some_and(|e| e.len() as u64 == count));
}

#[test]
fn one_of_two_simultaneous_commits_is_stale_and_a_commit_outlives_its_window() {
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &[]);
    let open = |pixel: [u32; 2]| {
        let (mut window, welcome) = Window::open(&server);
        window.say(&view(&welcome, 0.5, "colour", false));
        window.say(&json!({ "type": "pick", "id": 1, "pixel": pixel, "within": null, "meaning": null }));
        window.wait_for(|m| m["type"] == "picked");
        window
    };
    let commit = |base: &Value, name: &str| json!({ "type": "commit", "id": 2, "base": base, "name": name });
    let (mut first, mut second) = (open([16, 16]), open([15, 16]));
    let base = first.document["revision"].clone();
    first.say(&commit(&base, "one"));
    second.say(&commit(&base, "two"));
    let mut answers = [&mut first, &mut second].map(|w| w.wait_for(|m| m["id"] == 2)["type"].clone());
    answers.sort_by_key(ToString::to_string);
    assert_eq!(answers, ["done", "error"]);
    let names = || list(root).iter().map(|s| s["name"].as_str().unwrap().to_owned()).collect::<Vec<_>>();
    assert_eq!(names().iter().filter(|n| ["one", "two"].contains(&n.as_str())).count(), 1);

    let mut third = open([16, 16]);
    let base = third.document["revision"].clone();
    third.say(&commit(&base, "three"));
    // what follows it is answered, so it was received
    third.say(&json!({ "type": "command", "id": 3 }));
    third.wait_for(|m| m["id"] == 3);
    drop(third);
    first.wait_for(|m| m["type"] == "document" && m["segments"].to_string().contains("three"));
    assert!(names().contains(&"three".to_owned()));
}

#[test]
fn a_selection_stays_in_its_segment_when_that_is_renamed() {
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &[]);
    let (mut window, welcome) = Window::open(&server);
    window.say(&view(&welcome, 0.5, "colour", false));
    window.say(&json!({ "type": "pick", "id": 1, "pixel": [16, 16], "within": null, "meaning": null }));
    window.wait_for(|m| m["type"] == "picked");
    let old: Vec<String> = list(root).iter().map(|s| s["name"].as_str().unwrap().to_owned()).collect();
    for (k, name) in old.iter().enumerate() {
        volseggs().current_dir(root).args(["segment", "rename", "run", name, &format!("new-{k}")]).assert().success();
    }
    let last = format!("new-{}", old.len() - 1);
    window.wait_for(|m| m["type"] == "document" && m["segments"].to_string().contains(&last));
    window.say(&json!({ "type": "adjust", "id": 2, "meaning": { "by": { "scale": 0.9, "threshold": -1.0 } } }));
    let adjusted = window.wait_for(|m| m["id"] == 2);
    assert_eq!(adjusted["type"], "picked", "{adjusted}");
    let base = window.document["revision"].clone();
    window.say(&json!({ "type": "commit", "id": 3, "base": base, "name": "part" }));
    assert_eq!(window.wait_for(|m| m["id"] == 3)["type"], "done");
    let part = list(root).into_iter().find(|s| s["name"] == "part").unwrap();
    assert!(part["parent"].as_str().is_some_and(|parent| parent.starts_with("new-")), "{part}");
}
