//! What the commands write, as whole programs: impossible sizes and numbers, folders and files that are replaced and
//! those that are not, formats, and what is left behind.

use crate::common::{copy, json, names, refused, text, volseggs, with_segments};
use assert_cmd::Command;
use serde_json::{Value, json};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use tempfile::TempDir;
use volseggs::model::scene_file::read_tensors;
use volseggs::train::checkpoint;

/// A folder with the dataset in `data` and a run with segments in `run`, made once; nothing writes into it.
fn made_once() -> &'static Path {
    static ROOT: OnceLock<PathBuf> = OnceLock::new();
    ROOT.get_or_init(|| with_segments("outputs", &["--clusters", "2"]))
}

/// A folder with a copy of the run.
pub fn with_run() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    copy(&made_once().join("run"), &folder.path().join("run"));
    folder
}

/// Returns the program in `root` with space-separated arguments.
pub fn call(root: &Path, arguments: &str) -> Command {
    let mut command = volseggs();
    command.current_dir(root).args(arguments.split_whitespace());
    command
}

/// Returns every file below a folder with its bytes, without locks.
fn bytes_of(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    for name in names(folder) {
        let path = folder.join(name);
        if path.is_dir() {
            found.extend(bytes_of(&path));
        } else if !path.ends_with(".lock") {
            found.push((path.clone(), std::fs::read(&path).unwrap()));
        }
    }
    found
}

/// Returns the name of a temporary of `name` as a killed process leaves it: no process has such a high number.
pub fn leftover(name: &str) -> String {
    let processes = std::fs::read_link("/proc/self/ns/pid").unwrap_or_default();
    let host = format!("{}{}", volseggs::process::host_name().unwrap_or_default(), processes.display());
    let host = host.bytes().fold(0x811c_9dc5, |h: u32, b| (h ^ u32::from(b)).wrapping_mul(0x0100_0193));
    format!(".tmp-{name}-4294967290@{host:08x}-0")
}

/// Writes a small series of volumes with a ball into `root`: 8-bit values from 0 to 253.
pub fn write_volume(root: &Path) {
    let value = |i: usize| {
        let [x, y, z] = [i % 12, i / 12 % 12, i / 144].map(|v| v as f64 - 5.5);
        (253.0 - 46.0 * (x * x + y * y + z * z).sqrt()).clamp(0.0, 253.0) as u8
    };
    for step in 0..3 {
        std::fs::write(root.join(format!("v_{step}.raw")), (0..1728).map(value).collect::<Vec<u8>>()).unwrap();
        std::fs::write(root.join(format!("v_{step}.raw.toml")), "dims = [12, 12, 12]\ntype = \"u8\"\n").unwrap();
    }
}

/// Returns `prepare` in `root` of the volumes there, into `data`; flags in `changes` replace the usual ones.
fn prepare(root: &Path, changes: &str) -> Command {
    let usual = "--volume v_0.raw v_1.raw v_2.raw --transfer-function ramp --size 16 --times 2 --views 2 \
                 --test-views 3 --segment-views 0 --out data";
    let flag = |words: &str| format!("--{}", words.split(' ').next().unwrap_or_default());
    let mut all = vec!["prepare".to_owned(), "--no-label-images".to_owned()];
    for words in usual.trim_start_matches("--").split(" --") {
        if !changes.split(' ').any(|c| c == flag(words)) {
            all.extend(format!("--{words}").split_whitespace().map(String::from));
        }
    }
    all.extend(changes.split_whitespace().map(String::from));
    let mut command = volseggs();
    command.current_dir(root).args(all);
    command
}

#[test]
fn impossible_numbers_are_refused() {
    let folder = with_run();
    let root = folder.path();
    let (_, newest) = checkpoint::list(&root.join("run")).pop().unwrap();
    let (_, metadata) = read_tensors(&newest.join("scene.safetensors")).unwrap();
    let spec: Value = serde_json::from_str(&metadata["volseggs"]).unwrap();
    let centre: Vec<f64> = spec["centre"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    let centre = format!("--camera={},{},{}", centre[0], centre[1], centre[2]);
    let before = names(root);
    let refuse = |command: &str, bad: &str, words: &[&str]| {
        let text = refused(&mut call(root, &format!("{command} {bad}")), words);
        assert_eq!(names(root), before, "{bad}: {text}");
    };
    let render = "render run --out frames --path orbit";
    for bad in ["--radius nan", "--radius 0", "--radius 1e300", "--radius -1", "--radius inf"] {
        refuse(render, bad, &["--radius"]);
    }
    refuse(render, "--radius 1e12", &["--radius", "too far away"]);
    let file = made_once().join("data/transforms_test.json");
    refuse(
        &format!("render run --out frames --path {}", file.display()),
        "--radius 2",
        &["--radius", "transforms_test.json", "defines the cameras"],
    );
    for bad in ["0", "99999999999", "1.5"] {
        refuse(render, &format!("--frames {bad}"), &["--frames", bad]);
    }
    for bad in ["--fps 0", "--fps 70000", "--time nan", "--time -0.1", "--size 100000", "--size 0"] {
        refuse(render, bad, &[bad.split(' ').next().unwrap()]);
    }
    refuse(render, "--memory 100M --size 4000", &["--size 4000: needs about", "--memory"]);
    for command in ["render run --out frames", "track run --segment red"] {
        for bad in ["nan,0,0", "inf,0,0", "1e300,0,0", "1,2", "1,2,3,4", "x"] {
            refuse(command, &format!("--camera={bad}"), &["--camera", "three finite numbers"]);
        }
    }
    refuse("render run --out frames", &centre, &["--camera", "is at the centre"]);
    refuse("render run --out frames", "--camera 1e12,0,0", &["--camera", "too far away"]);
    refuse("render run --out frames", "--camera 1,2,3 --frames 4", &["--camera", "--frames"]);
    refuse("render run --out frames", "--view -1", &["--view -1", "neither the number of a test view"]);
    refuse("render run --out frames", "--path spiral", &["--path spiral", "orbit", "transforms_"]);
}

#[test]
fn a_render_replaces_an_older_one_entirely_and_nothing_else() {
    let folder = with_run();
    let root = folder.path();
    let render =
        |out: &str, n: usize| call(root, &format!("render run --size 8 --path orbit --out {out} --frames {n}"));
    std::fs::create_dir(root.join(leftover("frames"))).unwrap();
    std::fs::write(root.join(leftover("frames")).join("0000.png"), "half").unwrap();
    render("frames", 6).assert().success();
    assert!(!root.join(leftover("frames")).exists(), "the leftovers of a killed render are removed");
    assert_eq!(names(&root.join("frames")).len(), 8);
    render("frames", 3).assert().success();
    assert_eq!(
        names(&root.join("frames")),
        ["0000.png", "0001.png", "0002.png", "animation.png", "frames.json"],
        "no frame of the longer render is left"
    );
    let record = json(&root.join("frames/frames.json"));
    assert_eq!((&record["frames"], &record["size"]), (&json!(3), &json!([8, 8])));
    assert_eq!((&record["run"], &record["path"], &record["show"]), (&json!("run"), &json!("orbit"), &json!("colour")));
    assert_eq!(record["times"], json!([0.0, 0.5, 1.0]));

    std::fs::write(root.join("frames/thesis.tex"), "x").unwrap();
    std::fs::write(root.join("file"), "x").unwrap();
    std::fs::create_dir(root.join("other")).unwrap();
    std::fs::write(root.join("other/0000.png"), "a photograph").unwrap();
    let before = bytes_of(root);
    for (out, words) in [
        ("frames", &["thesis.tex"][..]),
        ("run", &["run"]),
        (".", &["in use"]),
        ("..", &["in use"]),
        ("nowhere/..", &["does not end in a folder name"]),
        ("file", &["is a file"]),
        ("other", &["frames.json"]),
    ] {
        refused(&mut render(out, 2), words);
        assert!(bytes_of(root) == before, "--out {out}");
    }
    // a new folder inside a new folder
    render("a/b", 1).assert().success();
    assert_eq!(names(&root.join("a/b")), ["0000.png", "frames.json"]);
}

#[test]
#[cfg(target_os = "linux")]
fn folder_names_that_are_not_utf8_are_supported() {
    use std::os::unix::ffi::OsStringExt;
    let folder = with_run();
    let root = folder.path();
    write_volume(root);
    let commands = [
        call(root, "render run --size 8 --path orbit --frames 2 --json --out"),
        call(root, "export run --frames 2 --json --out"),
        call(root, "export run --format ply --json --out"),
        prepare(root, "--json --out"),
    ];
    for (i, mut command) in (0..).zip(commands) {
        let out = OsString::from_vec(vec![b'o', 0xff, b'0' + i]);
        let done = command.arg(&out).assert().success();
        serde_json::from_slice::<Value>(&done.get_output().stdout).unwrap();
        assert!(root.join(&out).exists(), "{command:?}");
    }
}

#[test]
fn the_format_of_an_export_follows_from_its_name() {
    let folder = with_run();
    let root = folder.path();
    let begin = |file: &str, mark: &[u8]| {
        let bytes = std::fs::read(root.join(file)).unwrap();
        assert!(bytes.starts_with(mark) && bytes[..300].windows(8).any(|w| w == b"volseggs"), "{file}");
    };
    for (file, mark) in
        [("a.ply", &b"ply\n"[..]), ("a.seg.nrrd", b"NRRD0004\n"), ("a.nrrd", b"NRRD0004\n"), ("a.vti", b"<?xml")]
    {
        let dims = if file == "a.ply" { "" } else { "--dims 6,6,6" };
        // twice: a file of its own is replaced
        for _ in 0..2 {
            call(root, &format!("export run --time 0.5 --out {file} {dims}")).assert().success();
        }
        begin(file, mark);
    }
    call(root, "export run --format ply --out scene.splat").assert().success();
    std::fs::write(root.join("thesis.ply"), "a thesis").unwrap();
    let before = bytes_of(root);
    for (arguments, words) in [
        ("--out scene.obj", &["scene.obj", ".seg.nrrd", "--format"][..]),
        ("--out scene", &["--out scene", "--format"]),
        ("--format vti --out lab.nrrd", &["--format vti", "lab.nrrd"]),
        ("--format ply --out lab.vti", &["--format ply", "lab.vti"]),
        ("--frames 2 --out lab.vti", &["--frames", "--format vti"]),
        ("--out missing/scene.ply", &["no folder missing"]),
        ("--out thesis.ply", &["thesis.ply", "not made by volseggs"]),
        ("--frames 2 --out run", &["run"]),
        ("--frames 2 --out .", &["in use"]),
        ("--frames 0 --out plys", &["--frames"]),
        ("--frames 99999999999999 --out plys", &["--frames 99999999999999: needs about"]),
        ("--time nan --out a.ply", &["--time"]),
        ("--dims 100000,100000,100000 --out l.nrrd", &["--dims 100000,100000,100000: needs about"]),
        ("--dims 99999999999,99999999999,99999999999 --out l.nrrd", &["needs about"]),
        ("--edited --out a.ply", &["--edited", "for labels"]),
        ("--edited --no-edits --dims 6,6,6 --out a.vti", &["--edited", "--no-edits"]),
        ("--out l.nrrd", &["has no prepare.json", "--like", "--dims"]),
    ] {
        refused(&mut call(root, &format!("export run {arguments}")), words);
        assert!(bytes_of(root) == before, "{arguments}");
    }
}

#[test]
fn an_export_of_several_times_replaces_an_older_one_entirely() {
    let folder = with_run();
    let root = folder.path();
    let export = |more: &str| call(root, &format!("export run --out many {more}"));
    std::fs::write(root.join(leftover("one.ply")), "half").unwrap();
    export("--frames 3").assert().success();
    assert!(!root.join(leftover("one.ply")).exists(), "the leftovers of a killed export are removed");
    export("--frames 2 --format vti --dims 5,5,5").assert().success();
    assert_eq!(names(&root.join("many")), ["0000.vti", "0001.vti", "export.json"]);
    let record = json(&root.join("many/export.json"));
    assert_eq!((&record["format"], &record["edited"]), (&json!("vti"), &json!(false)));
    assert_eq!(record["times"], json!([0.0, 1.0]));
    std::fs::write(root.join("many/notes.txt"), "x").unwrap();
    refused(&mut export("--frames 2"), &["notes.txt"]);
    // labels without a name go into the run, where several have a folder of their own
    for more in ["--frames 2", "--time 0.5", "--frames 3"] {
        call(root, &format!("export run --format nrrd --dims 5,5,5 {more}")).assert().success();
    }
    assert_eq!(names(&root.join("run/labels")), ["frames", "labels.nrrd"]);
    assert_eq!(names(&root.join("run/labels/frames")).len(), 4);
}

#[test]
fn a_track_needs_a_valid_name_and_stays_in_its_folder() {
    let folder = with_run();
    let root = folder.path();
    let file = root.join("run/segments/segments.safetensors");
    let segments = volseggs::segment::segmentation::Segmentation::load(&file).unwrap().segments;
    let name = segments.iter().max_by_key(|s| s.members.len()).unwrap().name.to_string();
    let before = bytes_of(root);
    let absolute = text(root, "run/checkpoints");
    for group in ["../checkpoints", "../segments", "", &absolute, ".", "..", "a/b"] {
        let mut track = call(root, "track run --frames 2");
        refused(track.args(["--segment", &name]).arg(format!("--group={group}")), &["--group", "cannot be a name"]);
    }
    for (bad, word) in [
        ("--frames 99999999999", "--frames 99999999999: needs about"),
        ("--frames 1", "at least 2"),
        ("--from nan", "--from"),
        ("--to 1.5", "--to"),
        ("--mask-alpha nan", "--mask-alpha"),
        ("--mask-alpha 2", "--mask-alpha"),
        ("--size 100000", "--size"),
    ] {
        refused(call(root, &format!("track run {bad}")).args(["--segment", &name]), &[word]);
    }
    assert!(bytes_of(root) == before, "the run is unchanged");
    std::fs::create_dir_all(root.join("run/track/mine")).unwrap();
    std::fs::write(root.join("run/track/mine/notes.txt"), "x").unwrap();
    refused(call(root, "track run --frames 2 --group mine").args(["--segment", &name]), &["mine"]);
    call(root, "track run --frames 2 --group both").args(["--segment", &name]).assert().success();
    assert!(root.join("run/track/both/statistics.json").is_file() && root.join("run/track/mine/notes.txt").is_file());
}

#[test]
fn prepare_replaces_a_dataset_and_nothing_else() {
    let folder = with_run();
    let root = folder.path();
    std::fs::create_dir_all(root.join("parent/volumes")).unwrap();
    write_volume(&root.join("parent/volumes"));
    std::fs::write(root.join("parent/thesis.tex"), "x").unwrap();
    std::fs::write(root.join("file"), "x").unwrap();
    let inside = root.join("parent/volumes");
    let into = |out: &str, more: &str| prepare(&inside, &format!("--out {out} {more}"));
    into("../../data", "").assert().success();
    refused(&mut into("../../data", ""), &["already exists", "--replace"]);
    let record = json(&root.join("data/prepare.json"));
    into("../../data", "--replace --size 8").assert().success();
    assert_eq!((&record["size"], &json(&root.join("data/prepare.json"))["size"]), (&json!([16, 16]), &json!([8, 8])));
    let before = bytes_of(root);
    // the volumes, a folder above them with other files, a run, a file, and the working directory
    for out in [".", "..", "../../parent", "../volumes", "../../run", "../../file", "../.."] {
        for replace in ["", "--replace"] {
            refused(&mut into(out, replace), &[]);
            assert!(bytes_of(root) == before, "--out {out} {replace}");
        }
    }
    // a dataset that contains its own source
    copy(&inside, &root.join("data/train/volumes"));
    refused(&mut prepare(&root.join("data/train/volumes"), "--replace --out ../.."), &["which is in use"]);
    refused(&mut prepare(root, "--replace --volume data/train/volumes/v_0.raw"), &["v_0.raw", "which is in use"]);
    assert!(root.join("data/train/volumes/v_2.raw").is_file());
    std::fs::remove_dir_all(root.join("data/train/volumes")).unwrap();
    // a file of someone else deep inside
    std::fs::write(root.join("data/train/mine.txt"), "x").unwrap();
    refused(&mut into("../../data", "--replace"), &["train/mine.txt", "does not belong to a dataset"]);
    assert!(root.join("data/train/mine.txt").is_file());
}

#[test]
fn an_output_folder_may_have_the_name_of_a_camera_path() {
    let folder = with_run();
    let render = |more: &[&str]| {
        let mut command = volseggs();
        command.current_dir(folder.path()).args(["render", "run", "--size", "8", "--out", "orbit"]).args(more);
        command
    };
    for _ in 0..2 {
        render(&["--path", "orbit", "--frames", "2"]).assert().success();
    }
    refused(&mut render(&["--path", "test", "--frames", "2"]), &["--frames", "--path orbit"]);
}

#[test]
fn prepare_names_the_invalid_flag() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    write_volume(root);
    std::fs::write(
        root.join("none.toml"),
        "name = \"none\"\ncolormap = \"cool-warm\"\nopacity = [[0.0, 0.0], [1.0, 0.0]]\n",
    )
    .unwrap();
    let before = names(root);
    for (bad, words) in [
        ("--fov 200", &["--fov"][..]),
        ("--radius 0", &["--radius"]),
        ("--radius 1e300", &["--radius 1e300"]),
        ("--sample-step 1e-30", &["--sample-step", "1/64"]),
        ("--size 100000", &["--size"]),
        ("--views 0", &["--views"]),
        ("--views 99999999999999999", &["--views 99999999999999999", "needs about"]),
        ("--test-views 99999999999999999", &["--test-views 99999999999999999: needs about"]),
        ("--memory 100M --size 4000", &["--size 4000x4000", "needs about"]),
        ("--time-values nan,1,2", &["--time-values"]),
        ("--label-names 1=../up", &["--label-names", "cannot be a name"]),
        ("--label-names 1=a,2=a", &["label 2=a"]),
        ("--transfer-function none.toml", &["every training image is empty", "volseggs inspect"]),
        ("--out nowhere/..", &["does not end in a folder name"]),
    ] {
        let text = refused(&mut prepare(root, bad), words);
        assert!(!text.contains("--side"), "{bad}: {text}");
        assert_eq!(names(root), before, "{bad}");
    }
    // negative numbers; a log without a terminal gets lines
    let done = prepare(root, "--time-values -1,1,2").assert().success();
    let log = String::from_utf8_lossy(&done.get_output().stderr).into_owned();
    assert!(log.lines().any(|l| l.starts_with("7/7 images")), "{log}");
    let times = json(&root.join("data/transforms_train.json"))["frames"].to_string();
    assert!(times.contains("\"time\":1.0"), "{times}");
}

#[test]
fn a_render_is_no_picture_of_another_format() {
    let folder = with_run();
    let root = folder.path();
    for name in ["q.gif", "q.JPG", "q.webm"] {
        refused(
            &mut call(root, &format!("render run --camera 3,-2,1.5 --out {name}")),
            &[name, ".png", ".mp4", "folder"],
        );
        assert!(!root.join(name).exists());
    }
}

#[test]
fn config_show_checks_what_train_checks() {
    let folder = tempfile::tempdir().unwrap();
    for json in ["", " --json"] {
        let call = |set: &str| call(folder.path(), &format!("config show --set {set}{json}"));
        refused(&mut call("loss.dssim=nan"), &["loss.dssim"]);
        refused(&mut call("init.opacity=2"), &["init.opacity"]);
        call("loss.dssim=0.1").assert().success();
    }
}

#[test]
fn steps_of_a_series_are_given_once_and_in_order() {
    let folder = tempfile::tempdir().unwrap();
    let prepare = "prepare --synthetic jets --dims 16 --series-steps 5 --size 16 --out data --steps";
    for (steps, words) in [("1,1", "1 after 1"), ("3,0", "0 after 3")] {
        let error = refused(&mut call(folder.path(), &format!("{prepare} {steps}")), &["--steps", words]);
        assert!(error.contains("ascending") && !folder.path().join("data").exists(), "{error}");
    }
}

#[test]
fn the_demo_refuses_a_folder_that_it_did_not_make() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    std::fs::create_dir_all(root.join("mine/data")).unwrap();
    std::fs::write(root.join("mine/data/notes.txt"), "x").unwrap();
    let text = refused(&mut call(root, "demo --size 16 --out mine"), &["not made by the demo", "--out"]);
    assert!(!text.contains("--replace"), "{text}");
    assert_eq!(names(&root.join("mine/data")), ["notes.txt"]);
    std::fs::write(root.join("file"), "x").unwrap();
    refused(&mut call(root, "demo --out file"), &["is a file"]);
}
