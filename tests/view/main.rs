//! `volseggs view` and `volseggs train --view` over the network: who is let in, what is drawn, and that actions there
//! do what commands do.
//!
//! Some tests have a short form, an ordinary part of `cargo test`, and a long one, which is the same code with more
//! rounds:
//!
//! | variable | meaning | default |
//! |---|---|---|
//! | `VOLSEGGS_VIEW_MESSAGES` | number of malformed messages | 2,000 |
//! | `VOLSEGGS_VIEW_SEED` | their seed | 1 |
//! | `VOLSEGGS_VIEW_CHANGES` | simultaneous changes by three windows and by commands | 60 |
//! | `VOLSEGGS_VIEW_FRAMES` | frames between the two measurements of the viewer's memory | 400 |
#![cfg(feature = "view")]
#![allow(clippy::unwrap_used)]

mod access;
mod beside;
mod browser;
mod changes;
#[path = "../common/mod.rs"]
mod common;
mod compare;
mod door;
mod gizmo;
mod jobs;
mod matrix;
mod modules;
mod noise;
mod page;
mod soak;
mod socket;
mod take;
mod tracks;
mod tree;
mod watch;
mod work;

use common::{SIZE, copy, run_json, volseggs};
use serde_json::{Value, json};
use socket::{Server, Window};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// A run with coarse segments, masks and an affinity field.
static RUN: LazyLock<PathBuf> = LazyLock::new(|| {
    let root = common::with_segments("view", &["--clusters", "2"]);
    run_json(&root, &["segment", "masks", "run", "--views", "5", "--size", "64"]);
    run_json(&root, &["segment", "fine", "run", "--steps", "60", "--pixels", "256"]);
    root
});

/// Copies the run.
fn run() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    copy(&RUN.join("run"), &folder.path().join("run"));
    folder
}

/// Reads a number from the environment; see the top of this file.
fn setting(name: &str, or: u64) -> u64 {
    let Ok(text) = std::env::var(name) else { return or };
    text.parse().unwrap_or_else(|_| panic!("{name}={text}: a whole number"))
}

/// Returns the view from (3, -2, 1.5).
fn view(welcome: &Value, time: f64, look: &str, moving: bool) -> Value {
    json!({
        "type": "view", "eye": [3.0, -2.0, 1.5], "target": welcome["centre"], "up": [0.0, 0.0, 1.0], "fov": welcome["fov"],
        "size": [SIZE, SIZE], "time": time, "look": look, "edits": true, "moving": moving,
    })
}

fn list(root: &Path) -> Vec<Value> {
    run_json(root, &["segment", "list", "run"])["segments"].as_array().unwrap().clone()
}

#[test]
fn the_picture_at_rest_matches_that_of_render() {
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &[]);
    let (mut window, welcome) = Window::open(&server);
    let coarse = list(root)[0]["name"].as_str().unwrap().to_owned();
    run_json(root, &["edit", "opacity", "run", "--segment", &coarse, "--factor", "0.5"]);
    for (look, flags) in [
        ("colour", &[][..]),
        ("segments", &["--show", "segments"]),
        ("depth", &["--show", "depth"]),
        ("affinity", &["--show", "affinity"]),
        ("velocity speed", &["--show", "velocity", "--velocity-axis", "speed"]),
    ] {
        let still = root.join(look.replace(' ', "-"));
        let out = still.display().to_string();
        let camera = ["render", "run", "--camera", "3,-2,1.5", "--time", "0.3", "--out", &out];
        volseggs().current_dir(root).args(camera).args(flags).assert().success();
        window.wait_for(|m| m["type"] == "document" && m["edits"].as_array().is_some_and(|e| e.len() == 1));
        window.say(&view(&welcome, 0.3, look, false));
        let frame = window.lossless();
        assert_eq!((frame.width, frame.height, frame.png), (SIZE, SIZE, true));
        assert!(
            frame.picture == std::fs::read(still.join("0000.png")).unwrap(),
            "{look}: different bytes from render's"
        );
    }
    for (look, palette, flags) in [
        ("velocity y", "cool-warm", &["--show", "velocity", "--velocity-axis", "y"][..]),
        ("depth", "cividis", &["--show", "depth"]),
    ] {
        let camera = ["render", "run", "--camera", "3,-2,1.5", "--time", "0.3", "--out", "still", "--palette", palette];
        volseggs().current_dir(root).args(camera).args(flags).assert().success();
        let mut wanted = view(&welcome, 0.3, look, false);
        wanted["palette"] = palette.into();
        window.say(&wanted);
        let legend = window.wait_for(|m| m["type"] == "legend" && m["legend"].is_object());
        assert_eq!(legend["legend"]["scale"].as_array().unwrap().len(), 33);
        window.say(&json!({ "type": "still", "id": 1 }));
        let still = image::load_from_memory(&window.frame(|f| f.kind == 2).picture).unwrap();
        assert!(still.to_rgb8() == image::open(root.join("still/0000.png")).unwrap().to_rgb8(), "{look}");
    }
    let wrong = ["render", "run", "--show", "depth", "--palette", "red-green", "--out", "x"];
    volseggs().current_dir(root).args(wrong).assert().failure().code(2);
}

#[test]
fn the_page_is_told_the_units_of_the_data() {
    let folder = run();
    let path = folder.path().join("run/run.json");
    let mut record = common::json(&path);
    let known = json!({
        "space": { "centre": [1000.0, -5.0, 3.5], "scale": 72.0, "unit": "mm" },
        "time": { "start": 100.0, "end": 300.0, "unit": "s" },
    });
    record["calibration"].clone_from(&known);
    std::fs::write(&path, record.to_string()).unwrap();
    let name = list(folder.path())[0]["name"].as_str().unwrap().to_owned();
    run_json(folder.path(), &["edit", "translate", "run", "--segment", &name, "--by", "7.2,0,0"]);

    let server = Server::start(folder.path(), &[]);
    let (mut window, welcome) = Window::open(&server);
    assert_eq!((&welcome["calibration"], &welcome["units"]["speed"]), (&known, &json!("mm/s")));
    let document = window.wait_for(|m| m["type"] == "document");
    assert_eq!(document["edits"], json!([format!("move {name} by (7.2, 0, 0) mm")]));
    window.say(&view(&welcome, 0.3, "depth", false));
    let legend = window.wait_for(|m| m["type"] == "legend" && m["legend"].is_object());
    assert_eq!(legend["legend"]["unit"], "mm");
    for k in 0..2 {
        let [shown, scene] = ["range", "scene_range"].map(|name| legend["legend"][name][k].as_f64().unwrap());
        assert!((shown - 72.0 * scene).abs() < 1e-4, "{legend}");
    }
}

#[test]
fn a_window_without_acknowledgements_gets_two_frames_and_the_newest_view_wins() {
    let folder = run();
    let server = Server::start(folder.path(), &[]);
    let (mut window, welcome) = Window::open(&server);
    window.takes = false;
    for k in 0..1000 {
        window.say(&view(&welcome, f64::from(k) / 999.0, "colour", true));
    }
    window.say(&view(&welcome, 0.7, "colour", false));
    let frames = window.frames_within(2.0);
    assert_eq!(frames.len(), 2, "at most two frames are in flight");
    window.takes = true;
    window.say(&json!({ "type": "ack", "frame": frames[1].number }));
    assert!((window.lossless().time - 0.7).abs() < 1e-6, "outdated views are not drawn");
}

#[test]
fn a_click_makes_the_same_segment_as_pick() {
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &[]);
    let (mut window, welcome) = Window::open(&server);
    let mut revision = window.document["revision"].as_u64().unwrap();
    window.say(&view(&welcome, 0.5, "colour", false));
    for (n, meaning, flags) in [
        (1, Value::Null, &[][..]),
        (2, json!({ "by": { "scale": 0.3, "threshold": 0.7 } }), &["--scale", "0.3", "--threshold", "0.7"]),
        (3, json!({ "level": 1 }), &["--level", "1"]),
    ] {
        window.say(&json!({ "type": "pick", "id": n, "pixel": [16, 16], "within": null, "meaning": meaning }));
        let picked = window.wait_for(|m| m["type"] == "picked" && m["id"] == n);
        window.say(&json!({ "type": "commit", "id": 10 + n, "base": revision, "name": format!("viewed{n}") }));
        window.wait_for(|m| m["type"] == "done" && m["id"] == 10 + n);
        let name = format!("typed{n}");
        let typed =
            ["segment", "pick", "run", "--camera", "3,-2,1.5", "--pixel", "16,16", "--time", "0.5", "--name", &name];
        let made = run_json(root, &[&typed[..], flags].concat());
        // Gaussians seen at other times join the picked ones
        let count = |v: &Value| v.as_u64().unwrap();
        let then = count(&made["made"][1]) - count(&made["from_other_times"]);
        assert!(0 < then && then <= count(&picked["gaussians"]), "{made} {picked}");
        let has_both = |m: &Value| m["type"] == "document" && m["segments"].to_string().contains(&name);
        revision = window.wait_for(has_both)["revision"].as_u64().unwrap();
        let all = volseggs::segment::segmentation::Segmentation::load(&root.join("run/segments/segments.safetensors"));
        let all = all.unwrap();
        let [viewed, typed] = [&format!("viewed{n}"), &name].map(|name| all.get(name).unwrap().clone());
        assert_eq!((viewed.members, viewed.parent, viewed.origin), (typed.members, typed.parent, typed.origin));
    }
    // an adjustment of the last click, and a click outside the picture
    window.say(&json!({ "type": "pick", "id": 30, "pixel": [16, 16], "within": null, "meaning": null }));
    window.wait_for(|m| m["type"] == "picked" && m["id"] == 30);
    window.say(&json!({ "type": "adjust", "id": 31, "meaning": { "by": { "scale": 0.9, "threshold": -1.0 } } }));
    assert!(window.wait_for(|m| m["id"] == 31)["gaussians"].as_u64().unwrap() > 0);
    window.say(&json!({ "type": "pick", "id": 32, "pixel": [999, 0], "within": null, "meaning": null }));
    let error = window.wait_for(|m| m["id"] == 32);
    assert!(error["type"] == "error" && error["message"].as_str().unwrap().contains("32x32"), "{error}");
}

#[test]
fn changes_are_shared_and_saved_and_stale_ones_refused() {
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &[]);
    let (mut first, _) = Window::open(&server);
    let (mut second, _) = Window::open(&server);
    let name = first.document["segments"][0]["name"].as_str().unwrap().to_owned();
    let before = std::fs::read(root.join("run/segments/segments.safetensors")).unwrap();
    let change =
        |id: u32, base: &Value, change: Value| json!({ "type": "change", "id": id, "base": base, "change": change });
    let base = first.document["revision"].clone();
    let fade = json!({ "kind": "edit", "segments": [&name], "operation": { "opacity": { "factor": 0.5 } } });
    first.say(&change(1, &base, fade.clone()));
    first.wait_for(|m| m["type"] == "done");
    let seen = second.wait_for(|m| m["type"] == "document" && m["edits"].as_array().is_some_and(|e| e.len() == 1));
    assert_eq!(run_json(root, &["edit", "list", "run"])["operations"].as_array().unwrap().len(), 1);

    second.say(&change(2, &base, fade));
    let stale = second.wait_for(|m| m["id"] == 2);
    assert!(stale["message"].as_str().unwrap().contains("changed meanwhile"), "{stale}");
    // a command writes while the viewer runs, which notices it
    run_json(root, &["segment", "group", "run", "both", &name]);
    let newer = second.wait_for(|m| m["type"] == "document" && m["segments"].to_string().contains("both"));
    assert!(newer["revision"].as_u64() > seen["revision"].as_u64());
    second.say(&change(3, &newer["revision"], json!({ "kind": "segments", "undo": true })));
    let undone = second.wait_for(|m| m["type"] == "document" && !m["segments"].to_string().contains("both"));
    second.say(&change(4, &undone["revision"], json!({ "kind": "edits", "undo": true })));
    second.wait_for(|m| m["type"] == "document" && m["edits"].as_array().is_some_and(Vec::is_empty));
    let after = volseggs::segment::segmentation::Segmentation::load(&root.join("run/segments/segments.safetensors"));
    std::fs::write(root.join("before"), before).unwrap();
    let before = volseggs::segment::segmentation::Segmentation::load(&root.join("before")).unwrap();
    assert_eq!(after.unwrap().segments, before.segments);
    for (id, bad) in [
        (5, json!({ "kind": "edit", "segments": ["nobody"], "operation": "hide" })),
        (6, json!({ "kind": "remove", "segments": ["nobody"] })),
        (7, json!({ "kind": "segments", "undo": false, })),
    ] {
        let base = second.document["revision"].clone();
        second.say(&change(id, &base, bad));
        let answer = second.wait_for(|m| m["id"] == id);
        assert!(answer["type"] == "error" || id == 7, "{answer}");
    }
}

#[test]
fn a_read_only_viewer_changes_nothing() {
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &["--read-only"]);
    let (mut window, welcome) = Window::open(&server);
    assert_eq!(welcome["read_only"], true);
    let base = window.document["revision"].clone();
    window.say(
        &json!({ "type": "change", "id": 1, "base": base, "change": { "kind": "coarse", "time": 0.5, "clusters": 2 } }),
    );
    let refused = window.wait_for(|m| m["id"] == 1);
    assert!(refused["message"].as_str().unwrap().contains("--read-only"), "{refused}");
}
