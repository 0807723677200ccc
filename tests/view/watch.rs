//! Watching a run while another process trains it.

use crate::browser::Browser;
use crate::common::{self, BINARY, SIZE, dataset, run_json, train_arguments, volseggs};
use crate::socket::{Server, Window};
use crate::{run, view};
use serde_json::json;
use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use volseggs::train::checkpoint;

/// A long training in `run`.
struct Trainer {
    child: Child,
    root: TempDir,
}

impl Trainer {
    /// Starts it, and waits for its first checkpoint.
    fn start() -> Self {
        let root = dataset();
        let long = ["stages.joint_steps=200000", "output.checkpoint_every=25", "output.keep=2"];
        let mut command = Command::new(BINARY);
        command.args(train_arguments(root.path(), "run", &long)).stdout(Stdio::null()).stderr(Stdio::null());
        let trainer = Self { child: command.spawn().unwrap(), root };
        let started = Instant::now();
        while checkpoint::list(&trainer.run()).is_empty() {
            assert!(started.elapsed() < Duration::from_secs(60), "no checkpoint");
            std::thread::sleep(Duration::from_millis(20));
        }
        trainer
    }

    fn root(&self) -> &Path {
        self.root.path()
    }

    fn run(&self) -> PathBuf {
        self.root().join("run")
    }

    /// Stops it as Ctrl-C does; it leaves a last checkpoint, whose step is returned.
    fn interrupt(&mut self) -> usize {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
        self.child.wait().unwrap();
        checkpoint::list(&self.run()).pop().unwrap().0
    }
}

impl Drop for Trainer {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

#[test]
fn newer_checkpoints_are_shown_and_the_last_picture_matches_that_of_render() {
    let mut trainer = Trainer::start();
    let root = trainer.root().to_owned();
    let server = Server::start(&root, &[]);
    let (mut window, welcome) = Window::open(&server);
    let first = welcome["step"].as_u64().unwrap();
    window.say(&view(&welcome, 0.3, "colour", false));
    let log = window.wait_for(|m| m["type"] == "training" && m["loss"].as_array().is_some_and(|l| l.len() > 2));
    assert_eq!((&log["status"], &log["all"]), (&json!("running"), &json!(200_020)));
    let second = window.wait_for(|m| m["type"] == "welcome" && m["step"].as_u64() > Some(first));
    assert_ne!(second["scene"], welcome["scene"]);
    // the trainer holds the run's lock
    let base = window.document["revision"].clone();
    window.say(&json!({ "type": "job", "id": 1, "base": base, "task": { "kind": "fine", "steps": 1 } }));
    window.wait_for(|m| m["id"] == 1 || (m["type"] == "job" && m["end"]["failed"].is_string()));

    let last = trainer.interrupt();
    // the checkpoint and the end of the training may be reported in either order
    let [shown, over] = [Cell::new(false), Cell::new(false)];
    window.wait_for(|m| {
        shown.set(shown.get() || m["type"] == "welcome" && m["step"].as_u64() == Some(last as u64));
        over.set(over.get() || m["type"] == "training" && m["status"] == "interrupted");
        shown.get() && over.get()
    });
    let out = root.join("still").display().to_string();
    let still = ["render", "run", "--camera", "3,-2,1.5", "--time", "0.3", "--out", &out];
    volseggs().current_dir(&root).args(still).assert().success();
    window.say(&view(&welcome, 0.3, "colour", false));
    let picture = std::fs::read(root.join("still/0000.png")).unwrap();
    let until = Instant::now() + Duration::from_secs(60);
    loop {
        // a frame of the previous checkpoint may still be on its way
        let frame = window.lossless();
        assert_eq!((frame.width, frame.height), (SIZE, SIZE));
        if frame.picture == picture {
            break;
        }
        assert!(Instant::now() < until, "different bytes from render's");
    }

    // an incomplete checkpoint, such as one that a copying program has begun to write, is not read
    let half = trainer.run().join("checkpoints").join(checkpoint::folder_name(last + 1000));
    std::fs::create_dir_all(&half).unwrap();
    std::fs::write(half.join("scene.safetensors"), b"half").unwrap();
    std::thread::sleep(Duration::from_millis(1200));
    let (_, now) = Window::open(&server);
    assert_eq!(now["step"].as_u64(), Some(last as u64));
}

#[test]
fn a_user_watches_a_training() {
    let Some(mut browser) = Browser::start() else { return };
    let trainer = Trainer::start();
    let server = Server::start(trainer.root(), &[]);
    let tab = browser.open(&server.url());
    browser.wait(&tab, "/step [0-9,]+/.test(document.getElementById('scene').textContent)");
    let first = browser.eval(&tab, "document.getElementById('scene').textContent");
    let picture = browser.picture(&tab);
    browser.eval(&tab, "document.getElementById('training').open = true");
    browser.wait(
        &tab,
        "/^Training: running, .* steps; step .* is shown/.test(document.getElementById('training-figures').textContent)",
    );
    browser.wait(&tab, "document.querySelectorAll('#training-loss .line').length === 1");
    browser.wait(&tab, &format!("document.getElementById('scene').textContent !== {first}"));
    let until = Instant::now() + Duration::from_secs(60);
    while browser.picture(&tab) == picture {
        assert!(Instant::now() < until, "the picture does not change");
        std::thread::sleep(Duration::from_millis(50));
    }
    browser.wait(&tab, "document.querySelectorAll('#training-psnr .line').length === 2");
    browser.eval(&tab, "document.getElementById('training').scrollIntoView({ block: 'center' })");
    browser.shoot(&tab, "6-training");
    assert!(browser.wrong.is_empty(), "{:?}", browser.wrong);
}

#[test]
fn a_killed_training_is_not_reported_as_running() {
    let mut trainer = Trainer::start();
    let root = trainer.root().to_owned();
    let server = Server::start(&root, &[]);
    let (mut window, _) = Window::open(&server);
    window.wait_for(|m| m["type"] == "training" && m["status"] == "running");
    let status = || run_json(&root, &["inspect", "run"])["status"].clone();
    assert_eq!(status(), "running");
    trainer.child.kill().unwrap();
    trainer.child.wait().unwrap();
    window.wait_for(|m| m["type"] == "training" && m["status"] == "broken off");
    assert_eq!(status(), "broken off");
    assert_eq!(common::json(&root.join("run/run.json"))["status"], "running", "a killed process cannot record its end");
}

#[test]
fn segments_of_another_state_of_the_scene_are_hidden_but_kept() {
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &[]);
    let (mut window, welcome) = Window::open(&server);
    let name = window.document["segments"][0]["name"].as_str().unwrap().to_owned();
    run_json(root, &["edit", "hide", "run", "--segment", &name]);
    let file = root.join("run/segments/segments.safetensors");
    let before = std::fs::read(&file).unwrap();
    let longer = ["train", "--resume", "run", "--set", "stages.joint_steps=70"];
    volseggs().current_dir(root).args(longer).assert().success();

    let newer = window.wait_for(|m| m["type"] == "welcome" && m["step"].as_u64() > welcome["step"].as_u64());
    assert!(newer["note"].as_str().unwrap().contains("trained further since"), "{newer}");
    assert_eq!(newer["clicks"], false, "the field belongs to the previous scene");
    let document = window.wait_for(|m| m["type"] == "document" && m["segments"].as_array().is_some_and(Vec::is_empty));
    window.say(&view(&welcome, 0.3, "colour", false));
    assert!(window.lossless().png, "it is drawn without edits of missing segments");
    let coarse = json!({ "kind": "coarse", "time": 0.5, "clusters": 2 });
    window.say(&json!({ "type": "change", "id": 1, "base": document["revision"], "change": coarse }));
    let refused = window.wait_for(|m| m["id"] == 1);
    assert!(refused["message"].as_str().unwrap().contains("--replace"), "{refused}");
    assert!(std::fs::read(&file).unwrap() == before, "the previous segments are kept");

    volseggs().current_dir(root).args(["edit", "undo", "run"]).assert().success();
    run_json(root, &["segment", "coarse", "run", "--clusters", "2", "--replace"]);
    let document =
        window.wait_for(|m| m["type"] == "document" && m["segments"].as_array().is_some_and(|s| s.len() > 1));
    let coarse = json!({ "kind": "coarse", "time": 0.4, "clusters": 3 });
    window.say(&json!({ "type": "change", "id": 2, "base": document["revision"], "change": coarse }));
    assert_eq!(window.wait_for(|m| m["id"] == 2)["type"], "done");
}
