//! Physical units: what a calibrated run takes and gives in those of its data, and one that is not as normalised.

use crate::common::{copy, json, names, refused, run_json, volseggs, with_segments};
use assert_cmd::Command;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use tempfile::TempDir;
use volseggs::export::ply;
use volseggs::model::HostGaussians;

const CENTRE: [f64; 3] = [1000.0, -5.0, 3.5];
const SCALE: f64 = 72.0;

/// A folder with a run, made once; nothing writes into it.
fn made_once() -> &'static Path {
    static ROOT: OnceLock<PathBuf> = OnceLock::new();
    ROOT.get_or_init(|| with_segments("units", &["--clusters", "2"]))
}

/// A folder with a copy of the run as `plain` and as `run`, with lengths in mm and times from 100 to 300 s.
fn calibrated() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["plain", "run"] {
        copy(&made_once().join("run"), &folder.path().join(name));
    }
    let path = folder.path().join("run/run.json");
    let mut record = json(&path);
    record["calibration"] = json!({
        "space": { "centre": CENTRE, "scale": SCALE, "unit": "mm", "axes": "right-anterior-superior" },
        "time": { "start": 100.0, "end": 300.0, "unit": "s" },
    });
    std::fs::write(path, record.to_string()).unwrap();
    folder
}

fn call(root: &Path, arguments: &str) -> Command {
    let mut command = volseggs();
    command.current_dir(root).args(arguments.split_whitespace());
    command
}

/// Standard error of a command that succeeds.
fn said(root: &Path, arguments: &str) -> String {
    String::from_utf8(call(root, arguments).assert().success().get_output().stderr.clone()).unwrap()
}

/// The segments of the run.
fn segments(root: &Path) -> Vec<String> {
    let list = run_json(root, &["segment", "list", "run"]);
    list["segments"].as_array().unwrap().iter().map(|s| s["name"].as_str().unwrap().to_owned()).collect()
}

/// The header of a PLY as lines.
fn header(path: &Path) -> Vec<String> {
    let bytes = std::fs::read(path).unwrap();
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap();
    std::str::from_utf8(&bytes[..end]).unwrap().lines().map(str::to_owned).collect()
}

#[test]
fn times_of_the_data_are_accepted_wherever_a_time_is() {
    let folder = calibrated();
    let root = folder.path();
    let frame = |time: &str| {
        call(root, &format!("render run --path orbit --frames 2 --size 16 --time {time} --out frames"))
            .assert()
            .success();
        (std::fs::read(root.join("frames/0001.png")).unwrap(), json(&root.join("frames/frames.json")))
    };
    let (picture, record) = frame("data:150");
    assert_eq!((&picture, &record["times"]), (&frame("0.25").0, &json!([0.25, 0.25])));
    assert_eq!(record["calibration"]["time"]["unit"], "s");
    assert_ne!(picture, frame("data:250").0);

    let scene = |time: &str| {
        call(root, &format!("export run --refit 0 --time {time} --out scene.ply")).assert().success();
        ply::read(&root.join("scene.ply")).unwrap()
    };
    assert_eq!(scene("data:150"), scene("0.25"));
    let coarse = run_json(root, &["segment", "coarse", "run", "--replace", "--time", "data:200", "--clusters", "2"]);
    assert_eq!(coarse["segments"][0]["time"], 0.5);
    let masks = run_json(root, &["segment", "masks", "run", "--views", "2", "--time", "data:300"]);
    assert_eq!(masks["time"], 1.0);
    let name = &segments(root)[0];
    for (given, times) in
        [("--from data:150 --to data:100 --frames 2", [0.25, 0.0]), ("--at data:100 --at 0.25", [0.0, 0.25])]
    {
        call(root, &format!("track run --segment {name} {given}")).assert().success();
        let rows = json(&root.join("run/track").join(name).join("statistics.json"));
        let rows = rows.as_array().map_or_else(|| rows["statistics"].as_array().unwrap().len(), Vec::len);
        assert_eq!(rows, times.len());
    }
    call(root, "segment pick run --camera 0,-4,0 --pixel 16,16 --size 32 --time data:150").assert().success();

    for command in [
        "render run --path orbit --out no --time",
        "export run --out no.ply --time",
        "segment coarse run --replace --time",
        "segment masks run --replace --time",
        "segment pick run --camera 0,-4,0 --pixel 9,9 --time",
        &format!("track run --segment {name} --at"),
        &format!("track run --segment {name} --from"),
    ] {
        let flag = command.rsplit(' ').next().unwrap();
        refused(&mut call(root, &format!("{command} data:301")), &[flag, "data:301", "from 100 to 300 s"]);
        let plain = command.replacen(" run", " plain", 1);
        refused(&mut call(root, &format!("{plain} data:150")), &[flag, "--time-values", "between 0 and 1"]);
        refused(&mut call(root, &format!("{command} 1.5")), &[flag, "1.5", "data:150"]);
    }
    assert!(!root.join("no").exists() && !root.join("no.ply").exists());
}

#[test]
fn files_of_gaussians_say_their_coordinates_and_have_those_of_the_data_on_request() {
    let folder = calibrated();
    let root = folder.path();
    let said_so = said(root, "export run --refit 0 --time data:150 --out scene.ply");
    assert!(said_so.contains("at time 0.25 (150 s), in scene coordinates"), "{said_so}");
    let lines = header(&root.join("scene.ply"));
    for line in [
        "coordinates scene",
        "centre 1000 -5 3.5",
        "scale 72",
        "length_unit mm",
        "axes right-anterior-superior",
        "time 0.25",
        "physical_time 150",
        "time_unit s",
    ] {
        assert!(lines.contains(&format!("comment {line}")), "{line}: {lines:?}");
    }
    let lines = {
        said(root, "export plain --refit 0 --out plain.ply");
        header(&root.join("plain.ply"))
    };
    assert!(lines.contains(&"comment physical unknown".to_owned()), "{lines:?}");

    let report = run_json(
        root,
        &["export", "run", "--refit", "0", "--time", "0.25", "--units", "physical", "--out", "physical.ply"],
    );
    assert_eq!((&report["coordinates"], &report["physical_times"]), (&json!("physical"), &json!([150.0])));
    let [scene, physical] = ["scene.ply", "physical.ply"].map(|name| ply::read(&root.join(name)).unwrap());
    for (i, (a, b)) in scene.means.iter().zip(&physical.means).enumerate() {
        let expected = CENTRE[i % 3] + SCALE * f64::from(*a);
        assert!((f64::from(*b) - expected).abs() < 1e-3, "{i}: {b} {expected}");
    }
    for (a, b) in scene.log_scales.iter().zip(&physical.log_scales) {
        assert!((f64::from(b - a) - SCALE.ln()).abs() < 1e-5);
    }
    let rest = |g: &HostGaussians| (g.rotations.clone(), g.opacity_logits.clone(), g.sh.clone());
    assert_eq!(rest(&scene), rest(&physical));

    call(root, "export run --refit 0 --frames 3 --units physical --format spz --out files").assert().success();
    let record = json(&root.join("files/export.json"));
    assert_eq!(
        (&record["coordinates"], &record["physical_times"]),
        (&json!("physical"), &json!([100.0, 200.0, 300.0]))
    );
    assert_eq!(record["calibration"]["space"]["scale"], SCALE);
    let spz = std::fs::read(root.join("files/0001.spz")).unwrap();
    let comment = b"scale 72\nlength_unit mm";
    assert!(spz.windows(comment.len()).any(|w| w == comment), "the comment of the gzip stream");

    refused(
        &mut call(root, "export plain --units physical --out no.ply"),
        &["--units physical", "does not know", "prepare"],
    );
    refused(
        &mut call(root, "export run --units physical --dims 8,8,8 --out no.vti"),
        &["--units", "only for Gaussians"],
    );
    refused(&mut call(root, "export run --sh-degree 2 --out no.spz"), &["--sh-degree", "only for .ply"]);
    refused(&mut call(root, "export run --sh-degree 1 --refit 0 --out no.ply"), &["--sh-degree 1", "degree 2"]);
    call(root, "export run --sh-degree 2 --refit 0 --out small.ply").assert().success();
    let coefficients = |name: &str| header(&root.join(name)).iter().filter(|l| l.contains("f_rest_")).count();
    assert_eq!((coefficients("small.ply"), coefficients("scene.ply")), (24, 45));
    assert!(!names(root).iter().any(|name| name.starts_with("no.")));
}

#[test]
fn edits_take_lengths_and_positions_of_the_data() {
    let folder = calibrated();
    let root = folder.path();
    let name = &segments(root)[0];
    let edit = |arguments: &str| said(root, &format!("edit {arguments} --segment {name}"));
    let stored = |run: &str| json(&root.join(run).join("edits.json"))["operations"].clone();
    let note = "outside the box of the scene";
    let quiet = edit("translate run --by 7.2,0,-3.6");
    assert!(!quiet.contains(note), "{quiet}");
    edit("translate run --by 0.1,0,-0.05 --scene-units");
    edit("translate plain --by 0.1,0,-0.05");
    edit("rotate run --axis 0,0,1 --degrees 30 --about 1036,-41,3.5");
    edit("scale run --factor 2 --about 0.5,-0.5,0 --scene-units");
    let (ours, plain) = (stored("run"), stored("plain"));
    assert_eq!((&ours[0], &ours[1]), (&plain[0], &plain[0]), "the same in scene units");
    assert_eq!(ours[2]["operation"]["rotate"]["about"], json!([0.5, -0.5, 0.0]));
    assert_eq!(ours[3]["operation"]["scale"]["about"], json!([0.5, -0.5, 0.0]));
    let list = |run: &str| {
        let output = call(root, &format!("edit list {run}")).assert().success().get_output().stdout.clone();
        String::from_utf8(output).unwrap()
    };
    let listed = list("run");
    assert!(listed.contains(&format!("1. move {name} by (7.2, 0, -3.6) mm")), "{listed}");
    assert!(listed.contains("through (1036, -41, 3.5) mm") && listed.contains("about (1036, -41, 3.5) mm"), "{listed}");
    assert!(list("plain").contains(&format!("1. move {name} by (0.1, 0, -0.05)\n")), "{}", list("plain"));

    call(root, "edit clear run").assert().success();
    let noted = edit("translate run --by 10,0,0 --scene-units");
    assert!(noted.contains("note: ") && noted.contains(note) && noted.contains("(720, 0, 0) mm"), "{noted}");
    call(root, "edit undo run").assert().success();
    assert!(edit("translate plain --by 10,0,0").contains(note));
}

#[test]
fn depth_and_velocity_are_shown_in_units_of_the_data() {
    let folder = calibrated();
    let root = folder.path();
    let look = |run: &str, show: &str| {
        let orbit = format!("render {run} --path orbit --frames 2 --size 24 --out look --json {show}");
        let output = call(root, &orbit).assert().success().get_output().clone();
        (serde_json::from_slice::<Value>(&output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap())
    };
    for (show, factor, unit) in
        [("--show depth", SCALE, "mm"), ("--show velocity --velocity-axis speed", SCALE / 200.0, "mm/s")]
    {
        let (known, log) = look("run", show);
        assert!(log.contains(&format!("({unit})")), "{log}");
        assert_eq!(known["unit"], unit);
        let (plain, log) = look("plain", show);
        assert!(log.contains("(normalised)"), "{log}");
        assert_eq!((&plain["unit"], &plain["scene_range"]), (&json!("normalised"), &known["scene_range"]));
        for k in 0..2 {
            let [known, plain] = [&known, &plain].map(|report| report["range"][k].as_f64().unwrap());
            assert!((known - factor * plain).abs() <= 1e-6 * known.abs(), "{show}: {known} {plain}");
        }
    }
}
