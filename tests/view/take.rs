//! What users take away from the viewer: pictures that record what they show, and commands that draw them again.

use crate::common::{BINARY, SIZE, refused, run_json, volseggs};
use crate::socket::{Server, Window};
use crate::{list, run, view};
use serde_json::{Value, json};
use std::path::Path;
use std::process::Command;
use volseggs::run::saved::SavedView;

/// Returns the bytes of a frame that `render --view VIEW` writes.
fn rendered(root: &Path, view: &str, flags: &[&str]) -> Vec<u8> {
    let render = ["render", "run", "--view", view, "--out", "still"];
    volseggs().current_dir(root).args(render).args(flags).assert().success();
    std::fs::read(root.join("still/0000.png")).unwrap()
}

#[test]
fn a_saved_picture_and_its_command_draw_it_again() {
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &[]);
    let (mut window, welcome) = Window::open(&server);
    let names: Vec<String> = list(root).iter().map(|s| s["name"].as_str().unwrap().to_owned()).collect();
    run_json(root, &["edit", "opacity", "run", "--segment", &names[0], "--factor", "0.5"]);
    window.wait_for(|m| m["type"] == "document" && m["edits"].as_array().is_some_and(|e| e.len() == 1));
    for (id, (look, time, hidden, edits)) in (1..).zip([
        ("colour", 0.3, &names[..0], true),
        ("velocity x", 0.1, &names[..1], false),
        ("depth", 0.7, &names[1..2], true),
    ]) {
        // the colour scale is that of the first picture, even when the time changes later
        for time in [0.5, time] {
            let mut wanted = view(&welcome, time, look, false);
            (wanted["hidden"], wanted["edits"]) = (json!(hidden), json!(edits));
            window.say(&wanted);
            window.lossless();
        }
        let mut wanted = view(&welcome, time, look, false);
        (wanted["hidden"], wanted["edits"]) = (json!(hidden), json!(edits));
        window.say(&wanted);
        let seen = window.lossless();
        window.say(&json!({ "type": "still", "id": id }));
        let still = window.frame(|f| f.kind == 2);
        assert_eq!((still.number, still.width, still.png), (id, SIZE, true));
        let path = root.join("saved.png");
        std::fs::write(&path, &still.picture).unwrap();
        let saved = SavedView::read(&path).unwrap();
        assert_eq!((saved.view.time, &saved.view.look[..], &saved.view.hidden[..]), (time, look, hidden));
        assert_eq!((saved.view.eye, saved.scene.as_str().into()), ([3.0, -2.0, 1.5], welcome["scene"].clone()));
        assert_eq!(saved.view.range.is_some(), look != "colour");
        // the same pixels, and except for the text the same bytes
        let pixels = |bytes: &[u8]| image::load_from_memory(bytes).unwrap().to_rgb8();
        let again = rendered(root, "saved.png", &[]);
        assert!(pixels(&still.picture) == pixels(&again) && again == seen.picture, "{look}");
        let over = ["render", "run", "--view", "saved.png", "--out", "saved.png"];
        refused(volseggs().current_dir(root).args(over), &["saved.png", "is the file that --view reads"]);
        std::fs::write(root.join("view.json"), serde_json::to_string(&saved).unwrap()).unwrap();
        assert!(rendered(root, "view.json", &[]) == again);
        window.say(&json!({ "type": "command", "id": 10 }));
        let command = window.wait_for(|m| m["id"] == 10)["command"].as_str().unwrap().to_owned();
        let path = std::env::join_paths(
            [Path::new(BINARY).parent().unwrap().to_owned()]
                .into_iter()
                .chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
        );
        let mut shell = Command::new("sh");
        assert!(shell.args(["-c", &command]).env("PATH", path.unwrap()).current_dir(root).status().unwrap().success());
        assert!(std::fs::read(root.join("still/0000.png")).unwrap() == again, "{command}");
    }
    // the selection of a click is not part of it
    window.say(&view(&welcome, 0.5, "colour", false));
    let plain = window.lossless();
    window.say(&json!({ "type": "pick", "id": 20, "pixel": [16, 16], "within": null, "meaning": null }));
    window.wait_for(|m| m["id"] == 20);
    assert!(window.lossless().picture != plain.picture);
    window.say(&json!({ "type": "still", "id": 21 }));
    let still = window.frame(|f| f.kind == 2);
    std::fs::write(root.join("saved.png"), &still.picture).unwrap();
    assert!(rendered(root, "saved.png", &[]) == plain.picture);

    // at another size and time, and from a click
    let wide = rendered(root, "saved.png", &["--size", "48", "--time", "0.2"]);
    assert_eq!(image::load_from_memory(&wide).unwrap().width(), 48);
    let record: Value = serde_json::from_slice(&std::fs::read(root.join("still/frames.json")).unwrap()).unwrap();
    assert_eq!(
        (&record["path"], &record["times"], &record["show"]),
        (&json!("--view saved.png"), &json!([0.2]), &json!("colour"))
    );
    let picked = run_json(root, &["segment", "pick", "run", "--view", "saved.png", "--pixel", "16,16"]);
    assert!(picked["weight"].as_f64().unwrap() > 0.0);
}

#[test]
fn files_without_a_view_are_refused_by_name() {
    let folder = run();
    let root = folder.path();
    let refused = |view: &str, flags: &[&str], word: &str| {
        let render = ["render", "run", "--out", "still", "--view", view];
        let output = volseggs().current_dir(root).args(render).args(flags).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(view) && said.contains(word), "{view}: {said}");
        assert!(!root.join("still").exists());
    };
    refused("nothing.png", &[], "nor an existing file");
    refused("99999999999999999999999", &[], "neither the number");
    refused("9999", &[], "has views 0 to");
    std::fs::write(root.join("x.json"), "{\"view\":{}}").unwrap();
    refused("x.json", &[], "missing");
    refused("run", &[], "folder");
    image::RgbImage::new(3, 3).save(root.join("plain.png")).unwrap();
    refused("plain.png", &[], "without a view");
    let good = r#"{"eye":[3,0,0],"target":[0,0,0],"up":[0,0,1],"fov":0.5,"size":[8,8],"time":0.5,"look":"colour","edits":true}"#;
    std::fs::write(root.join("good.json"), good).unwrap();
    for flags in [&["--show", "depth"][..], &["--segment", "red"], &["--no-edits"], &["--frames", "3"]] {
        refused("good.json", flags, flags[0]);
    }
    std::fs::write(root.join("look.json"), good.replace("\"colour\"", "\"x\"")).unwrap();
    refused("look.json", &[], "look: must be colour");
    std::fs::write(root.join("who.json"), good.replace("\"edits\"", "\"alone\":[\"who\"],\"edits\"")).unwrap();
    refused("who.json", &[], "who");
}

/// Returns a path of two keyframes, as the viewer writes it to a file.
fn path_file(root: &Path) -> Value {
    let server = Server::start(root, &[]);
    let (mut window, welcome) = Window::open(&server);
    window.say(&view(&welcome, 0.5, "velocity speed", false));
    window.lossless();
    let key = |seconds: f64, time: f64, eye: [f64; 3]| json!({ "seconds": seconds, "time": time, "eye": eye, "target": welcome["centre"], "up": [0, 0, 1], "fov": welcome["fov"] });
    let keys = json!([key(0.0, 0.1, [3.0, -2.0, 1.5]), key(1.0, 0.7, [-2.0, 3.0, 1.0])]);
    window.say(&json!({ "type": "path", "id": 1, "keys": keys, "frames": 5 }));
    let answer = window.wait_for(|m| m["id"] == 1);
    let frames = answer["frames"].as_array().unwrap();
    assert_eq!((frames.len(), &frames[0]["eye"], frames[2]["time"].as_f64().unwrap()), (5, &keys[0]["eye"], 0.4));
    window.say(&json!({ "type": "path", "id": 2, "keys": keys, "frames": 1_000_000_000 }));
    assert_eq!(window.wait_for(|m| m["id"] == 2)["type"], "error");
    window.say(&json!({ "type": "path", "id": 3, "keys": [keys[0], keys[0]], "frames": 2 }));
    let error = window.wait_for(|m| m["id"] == 3);
    assert!(error["message"].as_str().unwrap().contains("keyframe 2: seconds"), "{error}");
    answer["file"].clone()
}

#[test]
fn a_path_becomes_frames_or_a_film() {
    let folder = run();
    let root = folder.path();
    let file = path_file(root);
    assert_eq!(file["command"], "volseggs render run --path path.json --out frames");
    std::fs::write(root.join("path.json"), file.to_string()).unwrap();
    let render = |flags: &[&str]| {
        let mut command = volseggs();
        command.current_dir(root).args(["render", "run", "--path", "path.json"]).args(flags);
        command
    };
    render(&["--out", "frames", "--frames", "4"]).assert().success();
    let record: Value = serde_json::from_slice(&std::fs::read(root.join("frames/frames.json")).unwrap()).unwrap();
    assert_eq!(
        (&record["frames"], &record["show"], &record["path"]),
        (&json!(4), &json!("velocity speed"), &json!("path.json"))
    );
    assert_eq!((&record["times"][0], &record["times"][3]), (&json!(0.1), &json!(0.7)));
    // a keyframe is the picture of its view, with the scale that was shown
    let mut first = file["view"].clone();
    (first["time"], first["eye"]) = (json!(0.1), file["keys"][0]["eye"].clone());
    assert!(first["range"].is_array());
    assert!(rendered(root, &first.to_string(), &[]) == std::fs::read(root.join("frames/0000.png")).unwrap());

    render(&["--out", "film.png", "--fps", "3"]).assert().success();
    let decoder = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(root.join("film.png")).unwrap()));
    assert_eq!(
        decoder.read_info().unwrap().info().animation_control().unwrap().num_frames,
        4,
        "one second and its last frame"
    );
    for (flags, word) in [
        (&["--out", "x", "--show", "depth"][..], "--show"),
        (&["--out", "x", "--radius", "3"], "--radius"),
        (&["--out", "path.json.png/x/y.png"], "no folder"),
    ] {
        let output = render(flags).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && said.contains(word), "{said}");
    }
}

#[cfg(unix)]
#[test]
fn a_film_is_what_ffmpeg_makes_of_all_frames_or_is_not_written() {
    use std::os::unix::fs::PermissionsExt;
    let folder = run();
    let root = folder.path();
    std::fs::write(root.join("path.json"), path_file(root).to_string()).unwrap();
    let bin = root.join("bin");
    std::fs::create_dir(&bin).unwrap();
    let film = |script: Option<&str>| {
        if let Some(script) = script {
            // a substitute for the program that keeps the frames as they arrive; its last argument is the file, as a
            // URL
            std::fs::write(
                bin.join("ffmpeg"),
                format!("#!/bin/sh\nfor url; do :; done; out=\"${{url#file:}}\"\n{script}\n"),
            )
            .unwrap();
            std::fs::set_permissions(bin.join("ffmpeg"), std::fs::Permissions::from_mode(0o755)).unwrap();
        }
        let mut command = volseggs();
        let path = script.map_or(bin.display().to_string(), |_| format!("{}:/usr/bin:/bin", bin.display()));
        command.current_dir(root).env("PATH", path);
        command.args(["render", "run", "--path", "path.json", "--frames", "3", "--out", "film.mp4"]);
        let output = command.output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let (code, said) = film(None);
    assert!(code == Some(2) && said.contains("needs the program `ffmpeg`"), "{said}");
    let (code, said) = film(Some("echo no such codec >&2; exit 3"));
    assert!(code == Some(1) && said.contains("no such codec"), "{said}");
    let left: Vec<_> = std::fs::read_dir(root).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert!(left.iter().all(|n| !n.to_string_lossy().contains("mp4")), "{left:?}");
    let (code, said) = film(Some("cat > \"$out\""));
    assert_eq!(code, Some(0), "{said}");
    let bytes = std::fs::read(root.join("film.mp4")).unwrap();
    let size = (SIZE * SIZE * 3) as usize;
    assert_eq!(bytes[3 * size..], *b"\0\0\0\x10freevolseggs", "a box that players skip");
    volseggs()
        .current_dir(root)
        .args(["render", "run", "--path", "path.json", "--frames", "3", "--out", "frames"])
        .assert()
        .success();
    let last = image::open(root.join("frames/0002.png")).unwrap().to_rgb8();
    assert!(bytes[2 * size..3 * size] == *last.as_raw());
    let (code, said) = film(Some("cat > \"$out\"; echo >> \"$out\""));
    assert_eq!(code, Some(0), "its own film is replaced: {said}");
    let other = b"\0\0\0\x18ftypisom of somebody else";
    std::fs::write(root.join("film.mp4"), other).unwrap();
    let (code, said) = film(Some("cat > \"$out\""));
    assert!(code == Some(2) && said.contains("was not made by volseggs"), "{said}");
    assert_eq!(std::fs::read(root.join("film.mp4")).unwrap(), other);
}
