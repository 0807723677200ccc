//! `volseggs edit`, and what `render` and `export` show of edits and segments, as whole programs on one small run.

use crate::common::{copy, json, names, refused, volseggs, with_segments};
use assert_cmd::Command;
use image::RgbImage;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use tempfile::TempDir;
use volseggs::export::ply;
use volseggs::model::HostGaussians;
use volseggs::name::Name;

/// A folder with the dataset in `data` and a run with segments in `run`, made once.
fn made_once() -> &'static Path {
    static ROOT: OnceLock<PathBuf> = OnceLock::new();
    ROOT.get_or_init(|| with_segments("edit", &["--clusters", "3", "--keep-outliers"]))
}

/// A copy of the run that a test may edit.
struct Run {
    folder: TempDir,
    /// The segments, largest first: name and number of Gaussians.
    segments: Vec<(String, usize)>,
}

impl Run {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        copy(&made_once().join("run"), &folder.path().join("run"));
        let file = made_once().join("run/segments/segments.safetensors");
        let all = volseggs::segment::segmentation::Segmentation::load(&file).unwrap();
        let mut segments: Vec<_> = all.segments.into_iter().map(|s| (s.name.to_string(), s.members.len())).collect();
        segments.sort_by_key(|s| std::cmp::Reverse(s.1));
        Self { folder, segments }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Returns a command in the folder of the run.
    fn command(&self, arguments: &[&str]) -> Command {
        let mut program = volseggs();
        program.current_dir(self.folder.path()).args(arguments);
        program
    }

    /// Runs `volseggs edit WHAT run REST` and returns standard output.
    fn edit(&self, what: &str, rest: &[&str]) -> String {
        let output = self.command(&["edit", what, "run"]).args(rest).assert().success().get_output().clone();
        String::from_utf8(output.stdout).unwrap()
    }

    /// Renders a picture from the front in the middle of time.
    fn render(&self, rest: &[&str]) -> RgbImage {
        let still = ["render", "run", "--camera", "0,-4,0", "--time", "0.5", "--size", "48", "--out", "still"];
        self.command(&still).args(rest).assert().success();
        image::open(self.path("still/0000.png")).unwrap().to_rgb8()
    }

    /// Exports the Gaussians as trained to a PLY and reads it.
    fn export(&self, rest: &[&str]) -> HostGaussians {
        self.command(&["export", "run", "--refit", "0", "--out", "one.ply"]).args(rest).assert().success();
        ply::read(&self.path("one.ply")).unwrap()
    }

    fn edits(&self) -> Option<Vec<u8>> {
        std::fs::read(self.path("run/edits.json")).ok()
    }
}

/// Returns the pixels that are not the white background.
fn drawn(image: &RgbImage) -> Vec<(f64, f64, [u8; 3])> {
    let pixels = image.enumerate_pixels().filter(|(_, _, p)| p.0 != [255; 3]);
    pixels.map(|(x, y, p)| (f64::from(x), f64::from(y), p.0)).collect()
}

#[test]
fn a_hidden_segment_vanishes_and_undo_restores_identical_bytes() {
    let run = Run::new();
    let (name, count) = run.segments[0].clone();
    let plain = run.render(&[]);
    let alone = run.render(&["--segment", &name]);
    assert!(drawn(&alone).len() > 20 && drawn(&alone).len() < drawn(&plain).len());
    let orbit = ["render", "run", "--path", "orbit", "--frames", "3", "--out"];
    run.command(&orbit).arg("before").assert().success();

    assert_eq!(run.edit("list", &[]), "no edits\n");
    assert_eq!(run.edits(), None, "listing edits writes nothing");
    assert_eq!(run.edit("hide", &["--segment", &name]), format!("1. hide {name}\n"));
    assert!(drawn(&run.render(&["--segment", &name])).is_empty());
    assert_ne!(run.render(&[]), plain);
    assert_eq!(run.render(&["--no-edits"]), plain);
    assert_eq!(run.export(&[]).len(), 400 - count);
    assert_eq!(run.export(&["--no-edits"]).len(), 400);
    assert_eq!(run.export(&["--segment", &name, "--no-edits"]).len(), count);
    refused(&mut run.command(&["export", "run", "--segment", &name, "--out", "no.ply"]), &["--no-edits"]);
    assert!(!run.path("no.ply").exists());

    let hidden = run.render(&[]);
    assert_eq!(run.edit("undo", &[]), format!("1. hide {name} (undone)\n"));
    run.command(&orbit).arg("after").assert().success();
    for file in names(&run.path("before")) {
        let bytes = |folder: &str| std::fs::read(run.path(folder).join(&file)).unwrap();
        assert!(bytes("before") == bytes("after"), "{file}");
    }
    run.edit("redo", &[]);
    assert_eq!(run.render(&[]), hidden);
    run.edit("show", &["--segment", &name]);
    assert_eq!(run.render(&[]), plain, "hiding and showing restores the picture");
    assert_eq!(run.export(&[]).len(), 400);

    let stack: Value = serde_json::from_str(&run.edit("list", &["--json"])).unwrap();
    assert_eq!(stack, json(&run.path("run/edits.json")));
    assert_eq!((&stack["operations"][0]["operation"], &stack["undone"]), (&"hide".into(), &Value::Array(vec![])));
    run.edit("undo", &["--count", "2"]);
    assert_eq!(run.edit("clear", &[]), "no edits\n");
}

#[test]
fn isolate_shows_only_the_segment() {
    let run = Run::new();
    let [one, two] = [0, 1].map(|i| run.segments[i].clone());
    let arguments = ["--segment", &one.0, "--segment", &two.0];
    let (alone, file) = (run.render(&arguments), run.export(&arguments));
    run.edit("isolate", &arguments);
    assert_eq!(run.render(&[]), alone);
    assert_eq!(file.len(), one.1 + two.1);
    assert_eq!(run.export(&[]), file);
}

#[test]
fn segments_change_colour_opacity_and_place() {
    let run = Run::new();
    let name = run.segments[0].0.as_str();
    let of = ["--segment", name];
    let only = |rest: &[&str]| run.render(&[&of, rest].concat());
    let plain = only(&[]);
    let centre = |image: &RgbImage| {
        let drawn = drawn(image);
        let n = drawn.len() as f64;
        (drawn.iter().map(|p| p.0).sum::<f64>() / n, drawn.iter().map(|p| p.1).sum::<f64>() / n)
    };

    run.edit("recolour", &[&of[..], &["--colour", "#00ff00", "--flat"]].concat());
    let green = only(&[]);
    assert!(drawn(&green).iter().all(|(_, _, [r, g, b])| r == b && *g >= 254), "{:?}", drawn(&green));
    assert!(drawn(&green).iter().any(|(_, _, [r, ..])| *r < 150));
    run.edit("opacity", &[&of[..], &["--factor", "0.2"]].concat());
    let darkest = |image: &RgbImage| drawn(image).iter().map(|(_, _, [r, ..])| *r).min().unwrap();
    assert!(darkest(&only(&[])) > darkest(&green));
    run.edit("undo", &["--count", "2"]);
    assert_eq!(only(&[]), plain);

    // seen from -y with z up: z is up in the picture
    let (x, y) = centre(&plain);
    run.edit("translate", &[&of[..], &["--by", "0,0,-0.3"]].concat());
    let (moved_x, moved_y) = centre(&only(&[]));
    assert!(moved_y > y + 2.0 && (moved_x - x).abs() < 1.0, "({x}, {y}) to ({moved_x}, {moved_y})");
    run.edit("undo", &[]);
    // half a turn about the line of sight mirrors every segment at the same point of the picture
    let mirrors = [0, 1].map(|i| {
        let of = ["--segment", run.segments[i].0.as_str()];
        let (x, y) = centre(&run.render(&of));
        run.edit("rotate", &[&of[..], &["--axis", "0,-1,0", "--degrees", "-180", "--about", "0,0,0"]].concat());
        let (turned_x, turned_y) = centre(&run.render(&of));
        (f64::midpoint(x, turned_x), f64::midpoint(y, turned_y))
    });
    assert!((mirrors[0].0 - mirrors[1].0).hypot(mirrors[0].1 - mirrors[1].1) < 1.0, "{mirrors:?}");
    run.edit("undo", &[]);
    let listed = run.edit("scale", &[&of[..], &["--factor", "0.5"]].concat());
    assert!(listed.contains("1. rotate") && listed.contains("2. scale") && !listed.contains("undone"), "{listed}");
    assert!(drawn(&only(&[])).len() < drawn(&plain).len());
    let ply = run.export(&["--segment", name]);
    assert_eq!(ply.len(), run.segments[0].1);
    assert_ne!(ply.means, run.export(&["--segment", name, "--no-edits"]).means);
}

#[test]
fn depth_velocity_and_segments_are_shown_in_colour() {
    let run = Run::new();
    let background = drawn(&run.render(&[])).len();
    let report = |rest: &[&str]| {
        let orbit = ["render", "run", "--path", "orbit", "--frames", "3", "--out", "look", "--json"];
        let output = run.command(&orbit).args(rest).assert().success().get_output().clone();
        let log = String::from_utf8(output.stderr).unwrap();
        (serde_json::from_slice::<Value>(&output.stdout).unwrap(), log)
    };
    let (depth, log) = report(&["--show", "depth"]);
    let [near, far] = [0, 1].map(|i| depth["range"][i].as_f64().unwrap());
    assert!(2.0 < near && near < far && far < 6.0, "{depth}");
    assert!(log.contains("depth (normalised)"), "{log}");
    let pixels = drawn(&run.render(&["--show", "depth"]));
    assert!(!pixels.is_empty() && pixels.len() <= background);

    for axis in ["x", "y", "z", "speed"] {
        let (velocity, log) = report(&["--show", "velocity", "--velocity-axis", axis]);
        let [low, high] = [0, 1].map(|i| velocity["range"][i].as_f64().unwrap());
        assert!(high > 0.0 && low == if axis == "speed" { 0.0 } else { -high }, "{velocity}");
        assert!(log.contains("(normalised)"), "{log}");
    }
    run.render(&["--show", "velocity"]);
    let (plain, _) = report(&[]);
    assert_eq!(plain.get("range"), None);

    let coloured = run.render(&["--show", "segments"]);
    assert_ne!(coloured, run.render(&[]));
    run.edit("hide", &["--segment", &run.segments[0].0]);
    assert_ne!(run.render(&["--show", "segments"]), coloured, "hidden segments are not shown here either");
    let name = run.segments[0].0.as_str();
    assert!(drawn(&run.render(&["--show", "segments", "--segment", name])).is_empty());

    let still = ["render", "run", "--camera", "0,-4,0", "--out", "no"];
    let refuse = |rest: &[&str], words: &[&str]| refused(run.command(&still).args(rest), words);
    refuse(&["--velocity-axis", "x"], &["--show velocity"]);
    refuse(&["--segment", "nobody"], &["nobody", name]);
    std::fs::remove_dir_all(run.path("run/segments")).unwrap();
    refuse(&["--no-edits", "--show", "segments"], &["segment coarse run"]);
    assert!(!run.path("no").exists());
}

#[test]
fn simultaneous_edits_are_all_kept() {
    let run = Run::new();
    let name = run.segments[0].0.as_str();
    std::thread::scope(|scope| {
        for i in 0..6 {
            let factor = format!("0.{}", i + 1);
            let mut command = run.command(&["edit", "opacity", "run", "--segment", name, "--factor", &factor]);
            scope.spawn(move || command.assert().success());
        }
    });
    assert_eq!(json(&run.path("run/edits.json"))["operations"].as_array().unwrap().len(), 6);
}

#[test]
fn refused_edits_change_nothing() {
    let run = Run::new();
    let name = run.segments[0].0.as_str();
    let refuse = |arguments: &[&str], words: &[&str]| {
        let before = run.edits();
        let listed = names(&run.path("run"));
        let (what, rest) = arguments.split_first().unwrap();
        let text = refused(run.command(&["edit", what, "run"]).args(rest), words);
        assert_eq!((run.edits(), names(&run.path("run"))), (before, listed), "{arguments:?}");
        text
    };
    let all = |run: &Run| {
        refuse(&["hide", "--segment", "nobody"], &["hide nobody", "no segment \"nobody\"", name]);
        refuse(&["hide"], &["--segment"]);
        let of = |what, rest: &[&'static str]| [&[what, "--segment", name], rest].concat();
        for (arguments, words) in [
            (of("recolour", &["--colour", "orange"]), &["--colour", "'#ff8800'"][..]),
            (of("opacity", &["--factor", "-1"]), &["--factor", "-1", "0 or above"]),
            (of("opacity", &["--factor", "nan"]), &["--factor", "nan"]),
            (of("scale", &["--factor", "0"]), &["--factor", "above 0"]),
            (of("scale", &["--factor", "inf"]), &["--factor", "above 0"]),
            (of("scale", &["--factor", "1e300"]), &["--factor", "1e300"]),
            (of("opacity", &["--factor", "inf"]), &["--factor", "inf"]),
            (of("translate", &["--by", "1e300,0,0"]), &["--by", "three finite numbers"]),
            (of("rotate", &["--axis", "0,0,1", "--degrees", "nan"]), &["--degrees", "finite"]),
            (of("translate", &["--by", "1,2"]), &["--by", "three finite numbers"]),
            (of("translate", &["--by", "-1,inf,0"]), &["--by", "three finite numbers"]),
            (of("rotate", &["--axis", "0,0,0", "--degrees", "-5"]), &["--axis", "direction"]),
            (of("rotate", &["--axis", "0,0,1", "--degrees", "5", "--about", "x"]), &["--about"]),
        ] {
            refuse(&arguments, words);
        }
        refuse(&["redo"], &["nothing to redo", "edits.json"]);
        run.edits()
    };
    assert_eq!(all(&run), None, "no file is created");
    refuse(&["undo"], &["nothing to undo", "edits.json"]);
    run.edit("hide", &["--segment", name]);
    assert!(all(&run).is_some());
    refuse(&["undo", "--count", "2"], &["--count 2", "between 1 and 1"]);
    refuse(&["undo", "--count", "0"], &["--count", "at least 1"]);
    refused(&mut run.command(&["edit", "list", "data"]), &["data", "no checkpoint"]);

    // a damaged file is reported, and can be cleared
    std::fs::write(run.path("run/edits.json"), "{").unwrap();
    refuse(&["list"], &["edits.json", "JSON"]);
    refuse(&["hide", "--segment", name], &["edits.json"]);
    refused(&mut run.command(&["render", "run", "--out", "no"]), &["edits.json"]);
    run.edit("clear", &[]);
    run.edit("hide", &["--segment", name]);
}

#[test]
fn edits_of_removed_segments_suggest_undo() {
    let run = Run::new();
    let name = run.segments[0].0.as_str();
    let file = run.path("run/segments/segments.safetensors");
    let mut all = volseggs::segment::segmentation::Segmentation::load(&file).unwrap();
    let mut part = all.get(name).unwrap().clone();
    (part.name, part.parent) = (Name::new("part").unwrap(), Some(Name::new(name).unwrap()));
    part.members.truncate(5);
    all.add(part).unwrap();
    all.save(&file).unwrap();
    let plain = run.render(&[]);
    run.edit("opacity", &["--segment", name, "--factor", "0.5"]);
    run.edit("hide", &["--segment", "part"]);
    run.edit("hide", &["--segment", name]);
    all.remove(|s| s.name == "part");
    all.save(&file).unwrap();

    let words = ["edits.json", "edit 2 (hide part)", "\"part\"", "volseggs edit undo run --count 2"];
    let render = ["render", "run", "--camera", "0,-4,0", "--time", "0.5", "--size", "48", "--out", "no"];
    let text = refused(&mut run.command(&render), &words);
    assert!(text.contains("--no-edits"), "{text}");
    refused(&mut run.command(&["export", "run", "--out", "no.ply"]), &words);
    refused(&mut run.command(&["edit", "show", "run", "--segment", name]), &words);
    assert!(!run.path("no").exists() && !run.path("no.ply").exists());
    assert_eq!(run.render(&["--no-edits"]), plain);
    run.edit("undo", &["--count", "2"]);
    run.render(&[]);
    refused(&mut run.command(&["edit", "redo", "run"]), &["hide part", "no segment \"part\"", name]);
    run.edit("undo", &[]);
    assert_eq!(run.render(&[]), plain);
}
