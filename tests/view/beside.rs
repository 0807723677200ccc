//! Viewing a run in the process that trains it.

use crate::browser::Browser;
use crate::common::{
    BINARY, dataset, json as read_json, metrics, newest_bytes, refused, train, train_arguments, volseggs,
};
use crate::socket::{Server, Window};
use crate::{run, view};
use serde_json::{Value, json};
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};
use volseggs::train::checkpoint;

/// Enough steps for a window to come and go.
const SETTINGS: [&str; 2] = ["stages.joint_steps=1500", "output.checkpoint_every=500"];

/// Starts a training in `root/run` with a viewer.
fn start(root: &Path, settings: &[&str], flags: &[&str]) -> Server {
    let mut command = Command::new(BINARY);
    command.args(train_arguments(root, "run", settings)).arg("--view").args(flags);
    Server::of(command)
}

fn pause(window: &mut Window, id: u32, pause: bool) {
    window.say(&json!({ "type": "pause", "id": id, "pause": pause }));
}

/// Waits for a message about the training whose live part satisfies `fits`.
fn training_message(window: &mut Window, fits: impl Fn(&Value) -> bool) -> Value {
    window.wait_for(|m| m["type"] == "training" && fits(&m["live"]))
}

fn is_paused(live: &Value) -> bool {
    live["paused"] == true
}

#[test]
fn watching_and_pausing_change_no_bit_and_the_last_picture_shows_the_final_scene() {
    let folder = dataset();
    let root = folder.path();
    train(root, "alone", &SETTINGS).assert().success();

    let mut server = start(root, &SETTINGS, &[]);
    let (mut window, welcome) = Window::open(&server);
    assert_eq!((&welcome["in_training"], &welcome["can_pause"]), (&json!(true), &json!(true)));
    pause(&mut window, 1, true);
    let first = training_message(&mut window, is_paused)["steps"].as_u64().unwrap();
    assert!(first < 1000, "{first} steps before the first window");
    // many pictures during each pause, with steps between the pauses
    let mut seen = Vec::new();
    let mut last = first;
    for id in [2, 4, 6] {
        for k in 0..20 {
            let look = if k % 2 == 0 { "colour" } else { "depth" };
            window.say(&view(&welcome, f64::from(k) / 19.0, look, true));
            window.frame(|f| f.kind == 0);
        }
        pause(&mut window, id, false);
        window.say(&view(&welcome, 0.3, "colour", false));
        training_message(&mut window, |live| live["steps"].as_u64() > Some(last + 20));
        pause(&mut window, id + 1, true);
        let now = training_message(&mut window, |live| is_paused(live) && live["shown"] == live["steps"]);
        window.say(&view(&welcome, 0.3, "colour", false));
        last = now["steps"].as_u64().unwrap();
        seen.push((last, window.lossless().picture));
    }
    assert!(seen.windows(2).all(|w| w[0].0 < w[1].0 && w[0].1 != w[1].1), "newer scenes look different");
    pause(&mut window, 9, false);
    let ended = window.wait_for(|m| m["type"] == "ended");
    assert!(ended["message"].as_str().unwrap().contains("complete after 1520 steps"), "{ended}");
    assert!(server.wait().success());

    let [alone, beside] = [root.join("alone"), root.join("run")];
    assert!(newest_bytes(&alone) == newest_bytes(&beside), "the scene or the optimiser differs");
    assert_eq!(metrics(&alone), metrics(&beside));
    let out = root.join("still").display().to_string();
    let still = ["render", "run", "--camera", "3,-2,1.5", "--time", "0.3", "--out", &out];
    volseggs().current_dir(root).args(still).assert().success();
    assert!(window.picture == std::fs::read(root.join("still/0000.png")).unwrap(), "different bytes from render's");
}

#[test]
fn a_pause_applies_to_every_window_and_a_signal_ends_it_with_a_checkpoint() {
    let folder = dataset();
    let root = folder.path();
    let mut server = start(root, &SETTINGS, &[]);
    let (mut first, _) = Window::open(&server);
    let (mut second, _) = Window::open(&server);
    pause(&mut second, 1, true);
    assert_eq!(second.wait_for(|m| m["id"] == 1)["type"], "done");
    let steps = training_message(&mut first, is_paused)["steps"].as_u64().unwrap();
    let log = || std::fs::metadata(root.join("run/metrics.jsonl")).unwrap().len();
    let before = log();
    std::thread::sleep(Duration::from_millis(700));
    assert_eq!(log(), before);
    let (mut third, _) = Window::open(&server);
    assert_eq!(training_message(&mut third, is_paused)["steps"].as_u64(), Some(steps), "no further step");

    pause(&mut first, 2, false);
    training_message(&mut third, |live| live["paused"] == false && live["steps"].as_u64() > Some(steps));
    pause(&mut first, 3, true);
    let later = |live: &Value| is_paused(live) && live["steps"].as_u64() > Some(steps);
    let steps = training_message(&mut second, later)["steps"].as_u64().unwrap();
    server.signal("TERM");
    let ended = third.wait_for(|m| m["type"] == "ended");
    assert!(ended["message"].as_str().unwrap().contains("interrupted"), "{ended}");
    assert_eq!(server.wait().code(), Some(1));
    let record = read_json(&root.join("run/run.json"));
    assert_eq!((&record["status"], record["steps"].as_u64()), (&json!("interrupted"), Some(steps)));
    assert_eq!(checkpoint::list(&root.join("run")).pop().unwrap().0 as u64, steps);

    let path = root.join("run").display().to_string();
    volseggs().args(["train", "--resume", &path]).assert().success();
    train(root, "alone", &SETTINGS).assert().success();
    assert!(newest_bytes(&root.join("run")) == newest_bytes(&root.join("alone")), "a pause changed the result");
}

#[test]
fn a_training_accepts_only_a_pause_and_not_even_that_when_read_only() {
    let folder = dataset();
    let root = folder.path();
    let server = start(root, &["stages.joint_steps=200000"], &[]);
    let (mut window, welcome) = Window::open(&server);
    assert_eq!((&welcome["read_only"], &welcome["clicks"]), (&json!(true), &json!(false)));
    let base = window.document["revision"].clone();
    let refuse = |window: &mut Window, id: u32, words: &str, mut what: Value| {
        what["id"] = id.into();
        window.say(&what);
        let answer = window.wait_for(|m| m["id"] == id);
        assert!(answer["type"] == "error" && answer["message"].as_str().unwrap().contains(words), "{answer}");
    };
    let coarse = json!({ "kind": "coarse", "time": 0.5, "clusters": 2 });
    for (id, what) in [
        (1, json!({ "type": "change", "base": base, "change": coarse })),
        (2, json!({ "type": "job", "base": base, "task": { "kind": "fine", "steps": 1 } })),
        (3, json!({ "type": "cancel", "job": 1 })),
    ] {
        refuse(&mut window, id, "is being trained here", what);
    }
    assert!(!root.join("run/segments").exists());
    drop(server);

    std::fs::remove_dir_all(root.join("run")).unwrap();
    let server = start(root, &SETTINGS, &["--read-only"]);
    let (mut window, welcome) = Window::open(&server);
    assert_eq!((&welcome["in_training"], &welcome["can_pause"]), (&json!(true), &json!(false)));
    refuse(&mut window, 1, "--read-only", json!({ "type": "pause", "pause": true }));
    drop(server);
    let trained = run();
    let server = Server::start(trained.path(), &[]);
    let (mut window, welcome) = Window::open(&server);
    assert_eq!(welcome["in_training"], false);
    refuse(&mut window, 1, "no training", json!({ "type": "pause", "pause": true }));
}

#[test]
fn a_viewer_that_cannot_start_prevents_the_training() {
    let folder = dataset();
    let root = folder.path();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    refused(train(root, "run", &[]).args(["--view", "--port", &port]), &[&port, "choose another --port"]);
    refused(train(root, "run", &[]).args(["--port", &port]), &["--view"]);
    refused(train(root, "run", &[]).args(["--read-only"]), &["--view"]);
    assert!(!root.join("run").exists());
}

#[test]
fn a_user_watches_and_pauses_a_training() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = dataset();
    let mut server = start(folder.path(), &["stages.joint_steps=200000"], &[]);
    let tab = browser.open(&server.url());
    let text = |id: &str| format!("document.getElementById('{id}').textContent");
    let step = format!("Number({}.match(/step ([0-9,]+)/)[1].replace(',', ''))", text("scene"));
    browser.wait(&tab, &format!("{step} >= 0"));
    let (first, picture) = (browser.eval(&tab, &step), browser.picture(&tab));
    // the part is open, and the picture is renewed by itself
    browser.wait(&tab, &format!("/steps.s, .* left, loss/.test({})", text("live-figures")));
    browser.wait(&tab, &format!("{step} > {first}"));
    let until = Instant::now() + Duration::from_secs(60);
    while browser.picture(&tab) == picture {
        assert!(Instant::now() < until, "the picture does not change");
        std::thread::sleep(Duration::from_millis(50));
    }
    browser.wait(&tab, "document.getElementById('pause').checkVisibility()");
    browser.eval(&tab, "document.getElementById('pause').click()");
    browser.wait(&tab, &format!("/^Training: paused, /.test({})", text("training-figures")));
    browser.wait(&tab, &format!("{} === 'resume' && {}.includes('is paused')", text("pause"), text("message")));
    browser.rests(&tab);
    let paused = browser.eval(&tab, &text("training-figures"));
    browser.shoot(&tab, "7-train-view");
    // another window sees the pause too, and ends it
    let other = browser.open(&server.url());
    browser.wait(&other, &format!("{} === {paused}", text("training-figures")));
    browser.eval(&other, "document.getElementById('pause').click()");
    browser.wait(&tab, &format!("/^Training: running, /.test({})", text("training-figures")));
    server.signal("INT");
    for tab in [&tab, &other] {
        browser.wait(tab, &format!("{}.includes('was interrupted after')", text("message")));
    }
    assert_eq!(server.wait().code(), Some(1));
    assert!(browser.wrong.is_empty(), "{:?}", browser.wrong);
}
