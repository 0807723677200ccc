//! The commands after training, as whole programs, on one small run.

use crate::common::{json, names, refused, text, train, volseggs, write_dataset};
use assert_cmd::Command;
use glam::DVec4;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use volseggs::config::types::Config;
use volseggs::data::{SplitName, Transforms};
use volseggs::export::ply;

/// A folder with the dataset in `data` and a run in `run`, made once.
fn root() -> &'static Path {
    static ROOT: OnceLock<PathBuf> = OnceLock::new();
    ROOT.get_or_init(|| {
        let root = Path::new(env!("CARGO_TARGET_TMPDIR")).join("commands");
        if root.exists() {
            std::fs::remove_dir_all(&root).unwrap();
        }
        write_dataset(&root.join("data"));
        train(&root, "run", &[]).assert().success();
        root
    })
}

/// Runs one evaluation at a time: it locks the run, and another is refused meanwhile.
fn eval_alone() -> MutexGuard<'static, ()> {
    static EVAL: Mutex<()> = Mutex::new(());
    EVAL.lock().unwrap_or_else(PoisonError::into_inner)
}

fn command(arguments: &[&str]) -> Command {
    let mut program = volseggs();
    let mut arguments = arguments.iter();
    program.args(arguments.next());
    program.arg(root().join("run")).args(arguments);
    program
}

/// Returns the standard output of a command that succeeds.
fn output(program: &mut Command) -> String {
    String::from_utf8(program.assert().success().get_output().stdout.clone()).unwrap()
}

fn is_png(path: &Path, width: u32, height: u32) {
    let image = image::open(path).unwrap();
    assert_eq!((image.width(), image.height()), (width, height), "{}", path.display());
}

#[test]
fn eval_writes_tables_and_pictures() {
    let _alone = eval_alone();
    let summary: Value = serde_json::from_str(&output(&mut command(&["eval", "--json"]))).unwrap();
    let folder = root().join("run/eval/test");
    assert_eq!(names(&folder), ["contact-sheet.png", "mean.json", "pictures", "psnr-over-time.svg", "views.csv"]);
    assert_eq!(json(&folder.join("mean.json")), summary);
    for field in ["psnr", "ssim", "ssim_gray", "training_seconds", "model_bytes", "gaussians", "views"] {
        assert!(summary[field].as_f64().unwrap() > 0.0, "{field}: {summary}");
    }
    // frame rates on the device alone, and with the copy of each image to the host
    for field in ["fps", "fps_frames", "fps_with_copy"] {
        assert!(summary[field].as_f64().unwrap() > 0.0, "{field}: {summary}");
    }
    for field in ["lpips_alex", "lpips_vgg"] {
        assert_eq!(summary.get(field), Some(&Value::Null), "{field}");
    }
    assert_eq!((&summary["views"], &summary["gaussians"], &summary["split"]), (&6.into(), &400.into(), &"test".into()));
    // all test views are at training times
    let groups = summary["by_distance"].as_array().unwrap();
    assert_eq!((groups.len(), &groups[0]["views"], &groups[0]["to"]), (1, &6.into(), &0.0.into()));
    assert_eq!(groups[0]["psnr"], summary["psnr"]);
    // compared with the training views, and by where the error lies
    let training = &summary["training_views"];
    assert!(training["psnr"].as_f64().unwrap() > 10.0 && training["views"] == training["of"], "{training}");
    for parts in [&summary["by_region"], &training["by_region"]] {
        for key in ["pixels", "error"] {
            let sum: f64 = ["edge", "interior", "outside"].map(|part| parts[part][key].as_f64().unwrap()).iter().sum();
            assert!((sum - 1.0).abs() < 1e-9, "{parts}");
        }
    }
    let scene = root().join("run/checkpoints/step-000080/scene.safetensors");
    assert_eq!(summary["model_bytes"], scene.metadata().unwrap().len());
    assert_eq!(summary["training_seconds"], json(&root().join("run/run.json"))["training_seconds"]);

    let csv = std::fs::read_to_string(folder.join("views.csv")).unwrap();
    let rows: Vec<Vec<&str>> = csv.lines().map(|l| l.split(',').collect()).collect();
    assert_eq!(rows[0], ["view", "time", "psnr", "ssim", "ssim_gray", "lpips_alex", "lpips_vgg"]);
    assert_eq!(rows.len(), 7);
    assert!(rows.iter().all(|r| r.len() == 7));
    assert_eq!((rows[1][0], rows[1][1], rows[6][1]), ("r_000", "0.000000", "1.000000"));
    let mean = rows[1..].iter().map(|r| r[2].parse::<f64>().unwrap()).sum::<f64>() / 6.0;
    assert!((mean - summary["psnr"].as_f64().unwrap()).abs() < 1e-3);
    let sheet = image::open(folder.join("contact-sheet.png")).unwrap();
    assert!(sheet.width() >= 3 * 32 && sheet.height() >= 6 * 32);
    assert!(std::fs::read_to_string(folder.join("psnr-over-time.svg")).unwrap().starts_with("<svg"));

    let text = output(&mut command(&["eval"]));
    for words in ["training views", "test views at a trained time", "edges of test views", "squared error, %"] {
        assert!(text.contains(words), "{words}: {text}");
    }
    let mut eval = command(&["eval", "--split", "train", "--views", "5"]);
    let text = output(&mut eval);
    let both = eval.output().unwrap();
    let said = [both.stdout, both.stderr].concat();
    assert_eq!(String::from_utf8_lossy(&said).matches("--lpips-weights").count(), 1, "said once");
    assert!(!text.contains("training views") && text.contains("edges of train views"), "{text}");
    assert!(text.contains("5 (32x32, train split)") && text.contains("LPIPS is null"), "{text}");
    let lines: Vec<&str> = text.lines().collect();
    let at = lines.iter().position(|l| l.starts_with("frames/second")).unwrap();
    let number = |line: &str| line.split_whitespace().find_map(|word| word.parse::<f64>().ok()).unwrap();
    assert!(
        number(lines[at]) > 0.0 && lines[at].contains("deformation and splatting, repeated for each frame"),
        "{text}"
    );
    assert!(!text.contains("with the copy"), "one figure on a CPU: {text}");
    let bytes = summary["model_bytes"].as_f64().unwrap();
    let size = format!("{:.2} MiB ({:.2} MB), scene.safetensors in f32", bytes / 1024.0 / 1024.0, bytes / 1e6);
    assert!(text.contains(&size), "{size}: {text}");
    let csv = std::fs::read_to_string(root().join("run/eval/train/views.csv")).unwrap();
    assert_eq!(csv.lines().count(), 6);
}

#[test]
fn results_of_another_dataset_get_a_separate_folder() {
    let _alone = eval_alone();
    command(&["eval", "--views", "3"]).assert().success();
    let own = root().join("run/eval/test/mean.json");
    let before = std::fs::read(&own).unwrap();
    let record = json(&root().join("run/run.json"));
    assert_eq!(json(&own)["fingerprint"], record["fingerprint"]);
    assert_eq!(json(&own)["dataset"], record["dataset"]);

    let other = root().join("other data");
    write_dataset(&other);
    let path = other.join("transforms_train.json");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text + "\n").unwrap();
    let other = other.display().to_string();
    let said = command(&["eval", "--views", "2", "--data", &other]).assert().success();
    let said = String::from_utf8_lossy(&said.get_output().stderr).into_owned();
    assert!(said.contains("is not the dataset") && said.contains("test-other-data"), "{said}");
    assert_eq!(std::fs::read(&own).unwrap(), before, "the results on the run's own data are gone");
    let mean = json(&root().join("run/eval/test-other-data/mean.json"));
    assert_ne!(mean["fingerprint"], record["fingerprint"]);
    assert!(mean["dataset"].as_str().unwrap().ends_with("other data"), "{mean}");
    // the same data again, wherever they are stored
    let copy = root().join("copy");
    write_dataset(&copy);
    command(&["eval", "--views", "2", "--data", &copy.display().to_string()]).assert().success();
    assert_ne!(std::fs::read(&own).unwrap(), before);

    // other test views with the same training views
    let before = std::fs::read(&own).unwrap();
    let path = copy.join("transforms_test.json");
    let mut views = json(&path);
    views["frames"].as_array_mut().unwrap().truncate(3);
    std::fs::write(&path, views.to_string()).unwrap();
    let said = command(&["eval", "--data", &copy.display().to_string()]).assert().success();
    let said = String::from_utf8_lossy(&said.get_output().stderr).into_owned();
    assert!(said.contains("has other views to measure than") && said.contains("test-copy"), "{said}");
    assert_eq!(std::fs::read(&own).unwrap(), before, "the results on the run's own test views are gone");
    assert_eq!(json(&root().join("run/eval/test-copy/mean.json"))["views"], 3);

    // files that do not belong to an evaluation stay
    std::fs::write(root().join("run/eval/test/notes.txt"), "mine").unwrap();
    refused(&mut command(&["eval", "--views", "2"]), &["notes.txt", "does not belong to an evaluation"]);
    std::fs::remove_file(root().join("run/eval/test/notes.txt")).unwrap();
}

#[test]
fn completions_are_printed_for_each_shell() {
    for shell in ["bash", "zsh", "fish"] {
        let script = output(volseggs().args(["completions", shell]));
        assert!(script.contains("volseggs") && script.contains("segment"), "{shell}");
    }
    refused(volseggs().args(["completions", "tcsh"]), &["tcsh", "bash"]);
}

#[test]
fn eval_refuses_missing_inputs() {
    let _alone = eval_alone();
    refused(&mut command(&["eval", "--split", "val"]), &["transforms_val.json"]);
    refused(&mut command(&["eval", "--data", "/nowhere"]), &["/nowhere", "--data"]);
    refused(&mut command(&["eval", "--views", "0"]), &["--views", "at least 1"]);
    refused(&mut command(&["eval", "--lpips-weights", "/nowhere.safetensors"]), &["/nowhere.safetensors"]);
}

#[test]
fn render_along_paths() {
    let folder = tempfile::tempdir().unwrap();
    let out = |name: &str| text(folder.path(), name);
    let orbit = output(&mut command(&["render", "--path", "orbit", "--frames", "4", "--out", &out("orbit"), "--json"]));
    let report: Value = serde_json::from_str(&orbit).unwrap();
    assert_eq!((&report["frames"], &report["width"]), (&4.into(), &32.into()));
    let path = folder.path().join("orbit");
    assert_eq!(names(&path), ["0000.png", "0001.png", "0002.png", "0003.png", "animation.png", "frames.json"]);
    is_png(&path.join("0003.png"), 32, 32);
    let animation = std::fs::read(path.join("animation.png")).unwrap();
    assert!(animation.windows(4).any(|w| w == b"acTL"));
    assert_ne!(std::fs::read(path.join("0000.png")).unwrap(), std::fs::read(path.join("0002.png")).unwrap());

    command(&["render", "--path", "test", "--size", "16", "--out", &out("test")]).assert().success();
    let files = names(&folder.path().join("test"));
    assert_eq!((files.len(), files[180].as_str()), (183, "0180.png"));
    is_png(&folder.path().join("test/0180.png"), 16, 16);

    let transforms = text(root(), "data/transforms_test.json");
    command(&["render", "--path", &transforms, "--out", &out("file")]).assert().success();
    assert_eq!(names(&folder.path().join("file")).len(), 8);

    let still = ["render", "--camera", "3,-2,-1.5", "--time", "0.25", "--size", "24", "--out", &out("still")];
    command(&still).assert().success();
    assert_eq!(names(&folder.path().join("still")), ["0000.png", "frames.json"]);
    is_png(&folder.path().join("still/0000.png"), 24, 24);
    let image = image::open(folder.path().join("still/0000.png")).unwrap().to_rgb8();
    assert!(image.pixels().any(|p| p.0 != [255; 3]), "nothing but background");
}

#[test]
fn an_orbit_is_centred_on_a_shifted_scene_and_needs_no_dataset() {
    let folder = crate::common::dataset();
    let root = folder.path();
    for name in [SplitName::Train, SplitName::Test] {
        let path = name.json_path(&root.join("data"));
        let mut poses = Transforms::read(&path).unwrap();
        poses.frames.iter_mut().for_each(|f| f.camera_to_world.w_axis += DVec4::new(40.0, -25.0, 10.0, 0.0));
        poses.write(&path).unwrap();
    }
    train(root, "far", &[]).assert().success();
    let shown = |out: &str| -> Vec<Vec<u8>> {
        let mut program = volseggs();
        program.args(["render", &text(root, "far"), "--path", "orbit", "--frames", "3", "--size", "32", "--out"]);
        program.arg(root.join(out)).assert().success();
        for n in 0..3 {
            let image = image::open(root.join(out).join(format!("{n:04}.png"))).unwrap().to_rgb8();
            let drawn: Vec<_> = image.enumerate_pixels().filter(|(_, _, p)| p.0 != [255; 3]).collect();
            let mean = |of: fn(u32, u32) -> u32| {
                drawn.iter().map(|(x, y, _)| f64::from(of(*x, *y))).sum::<f64>() / drawn.len() as f64
            };
            let (x, y) = (mean(|x, _| x), mean(|_, y| y));
            assert!((x - 15.5).abs() < 6.0 && (y - 15.5).abs() < 6.0, "picture {n}: around {x:.1}, {y:.1}");
        }
        (0..3).map(|n| std::fs::read(root.join(out).join(format!("{n:04}.png"))).unwrap()).collect()
    };
    let there = shown("there");
    std::fs::rename(root.join("data"), root.join("gone")).unwrap();
    assert!(shown("without") == there);
}

#[test]
fn render_refuses_invalid_options() {
    let folder = tempfile::tempdir().unwrap();
    let out = text(folder.path(), "out");
    let cases: [(&[&str], &[&str]); 4] = [
        (&["--time", "1.5"], &["--time", "1.5", "between 0 and 1"]),
        (&["--camera", "1,2"], &["--camera", "three finite numbers"]),
        (&["--size", "0"], &["--size", "'0'", "pixels"]),
        (&["--path", "spiral"], &["spiral"]),
    ];
    for (arguments, words) in cases {
        let mut program = command(&["render", "--out", &out]);
        refused(program.args(arguments), words);
        assert!(!folder.path().join("out").exists());
    }
}

#[test]
fn export_writes_conventional_ply_files() {
    let folder = tempfile::tempdir().unwrap();
    let one = folder.path().join("scene.ply");
    let as_trained = ["export", "--refit", "0", "--out"];
    command(&as_trained).args([&text(folder.path(), "scene.ply"), "--time", "0.5"]).assert().success();
    let bytes = std::fs::read(&one).unwrap();
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap();
    let header = std::str::from_utf8(&bytes[..end]).unwrap();
    let mut lines = header.lines();
    assert_eq!(lines.next(), Some("ply"));
    assert_eq!(lines.next(), Some("format binary_little_endian 1.0"));
    assert_eq!(lines.next(), Some("comment volseggs"));
    let mut lines = lines.skip_while(|line| line.starts_with("comment"));
    assert_eq!(lines.next(), Some("element vertex 400"));
    let properties: Vec<&str> = lines.map(|l| l.strip_prefix("property float ").unwrap()).collect();
    // the loader of 3DGS accepts no other number
    let rest: Vec<String> = (0..45).map(|i| format!("f_rest_{i}")).collect();
    let mut expected = vec!["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"];
    expected.extend(rest.iter().map(String::as_str));
    expected.extend(["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]);
    assert_eq!(properties, expected);
    assert_eq!(bytes.len() - end - 11, 400 * 4 * properties.len());

    let gaussians = ply::read(&one).unwrap();
    assert_eq!((gaussians.len(), gaussians.sh_degree()), (400, 3));
    for q in gaussians.rotations.chunks_exact(4) {
        assert!((q.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-4);
    }
    assert!(gaussians.means.iter().all(|v| v.abs() < 2.0));

    // compressed, by the ending of its name: a gzip stream, which ends with its length
    let small = folder.path().join("small.spz");
    let report = output(&mut command(&["export", "--time", "0.5", "--out", &small.display().to_string(), "--json"]));
    assert_eq!(serde_json::from_str::<Value>(&report).unwrap()["gaussians"], 400);
    let packed = std::fs::read(&small).unwrap();
    assert_eq!(packed[..2], [0x1f, 0x8b]);
    let length = u32::from_le_bytes(packed[packed.len() - 4..].try_into().unwrap());
    assert_eq!(length, 16 + 400 * (20 + 24), "degree 2");
    let frames = text(folder.path(), "spz-frames");
    output(command(&as_trained).args([&frames, "--frames", "2", "--format", "spz"]));
    assert_eq!(names(&folder.path().join("spz-frames")), ["0000.spz", "0001.spz", "export.json"]);
    refused(&mut command(&["export", "--dims", "8,8,8", "--out", "x.spz"]), &["--dims", "labels on voxels"]);
    refused(&mut command(&["export", "--refit", "9", "--out", "x.vti"]), &["--refit", "only for Gaussians"]);
    for steps in ["-1", "1000000"] {
        refused(&mut command(&["export", "--refit", steps, "--out", "x.ply"]), &["--refit", steps]);
    }

    let frames = text(folder.path(), "frames");
    let report = output(command(&as_trained).args([&frames, "--frames", "3", "--json"]));
    let report: Value = serde_json::from_str(&report).unwrap();
    assert_eq!(report["refit"], serde_json::json!([]));
    assert_eq!((report["gaussians"].as_u64(), report["files"].as_array().map(Vec::len)), (Some(400), Some(3)));
    assert_eq!(names(&folder.path().join("frames")), ["0000.ply", "0001.ply", "0002.ply", "export.json"]);
    let read = |name: &str| ply::read(&folder.path().join("frames").join(name)).unwrap();
    assert_eq!(read("0001.ply"), gaussians, "the middle frame is time 0.5");
    assert!(read("0000.ply").means != gaussians.means && read("0000.ply").sh == gaussians.sh);

    // by default opacities, scales and colours are refitted to how other viewers draw
    let frames = text(folder.path(), "refitted");
    let report = output(&mut command(&["export", "--frames", "2", "--out", &frames, "--json"]));
    let report: Value = serde_json::from_str(&report).unwrap();
    for (i, name) in ["0000.ply", "0001.ply"].iter().enumerate() {
        let psnr = |which: &str| report["refit"][i][which].as_f64().unwrap();
        assert!(psnr("psnr_after") > psnr("psnr_before") + 1.0, "{report}");
        let refitted = ply::read(&folder.path().join("refitted").join(name)).unwrap();
        let trained = read(["0000.ply", "0002.ply"][i]);
        assert_eq!((&refitted.means, &refitted.rotations), (&trained.means, &trained.rotations));
        assert!(refitted.opacity_logits != trained.opacity_logits);
    }
    assert_eq!(json(&folder.path().join("refitted/export.json"))["refit_steps"], 300);

    refused(&mut command(&["export", "--time", "2", "--out", "x.ply"]), &["--time", "'2'"]);
    refused(&mut command(&["export", "--frames", "0", "--out", &text(folder.path(), "none")]), &["--frames", "'0'"]);
    assert!(!folder.path().join("none").exists());
}

#[test]
fn config_shows_values_with_their_origins() {
    let folder = tempfile::tempdir().unwrap();
    let file = text(folder.path(), "mine.toml");
    std::fs::write(&file, "extends = \"quick\"\n[loss]\ntv = 0.5\n").unwrap();
    let mut show = volseggs();
    show.args(["config", "show", "--config", &file, "--set", "seed=7"]).env("VOLSEGGS_OPTIM__SH", "0.125");
    let shown = output(&mut show);
    let line = |key: &str| {
        let found = shown.lines().find(|l| l.starts_with(&format!("{key} = ")));
        found.unwrap_or_else(|| panic!("no {key} in {shown}"))
    };
    for (key, words) in [
        ("seed", ["7", "--set"]),
        ("loss.tv", ["0.5", "mine.toml:3"]),
        ("densify.budget", ["000", "preset quick:"]),
        ("optim.sh", ["0.125", "env VOLSEGGS_OPTIM__SH"]),
        ("init.box_half_size", ["1.3", "preset paper:"]),
        ("output.keep", ["2", "default"]),
    ] {
        assert!(words.iter().all(|w| line(key).contains(w)), "{}", line(key));
    }
    assert!(shown.parse::<toml::Table>().is_ok(), "what is shown is TOML");
    let best = output(volseggs().args(["config", "show", "--config", "best", "--json"]));
    assert_eq!(output(volseggs().args(["config", "show", "--json"])), best, "what is used without --config");
    let value: Value = serde_json::from_str(&best).unwrap();
    assert!(value["densify"]["budget"].is_u64());
    let words = ["--set", "unknown key `densify.budgett`", "did you mean `densify.budget`"];
    refused(volseggs().args(["config", "show", "--set", "densify.budgett=3"]), &words);
    let presets = output(volseggs().args(["config", "presets"]));
    assert!(["best:", "quick:", "paper:", "official:"].iter().all(|p| presets.contains(p)), "{presets}");
}

#[test]
fn the_committed_schema_is_current() {
    let schema: Value = serde_json::from_str(&output(volseggs().args(["config", "schema"]))).unwrap();
    assert!(schema["properties"]["densify"].is_object(), "{schema}");
    // editors show the built-in values
    let built_in = serde_json::to_value(Config::default()).unwrap();
    for key in ["dilation", "embedding", "sh_degree", "encoder"] {
        assert_eq!(schema["$defs"]["ModelConfig"]["properties"][key]["default"], built_in["model"][key], "{key}");
    }
    assert_eq!((&schema["properties"]["seed"]["default"], &built_in["seed"]), (&Value::from(0), &Value::from(0)));
    let committed = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/schema.json");
    if committed.exists() {
        assert!(json(&committed) == schema, "run: volseggs config schema > configs/schema.json");
    }
}

/// Returns the words of the last command that a text offers, as a shell reads them.
fn suggested(text: &str) -> Vec<String> {
    let start = text.rfind("volseggs ").unwrap_or_else(|| panic!("no command: {text}"));
    let command = text[start..].split(['`', '\n']).next().unwrap();
    let shell = std::process::Command::new("sh").args(["-c", &format!("printf '%s\\n' {command}")]).output().unwrap();
    String::from_utf8(shell.stdout).unwrap().lines().map(str::to_owned).collect()
}

#[test]
fn suggested_commands_can_be_copied_for_any_path() {
    let folder = crate::common::dataset();
    let root = folder.path();
    let run = text(root, "it's my run");
    let said = |command: &mut Command| String::from_utf8(command.output().unwrap().stderr).unwrap();
    assert_eq!(suggested(&said(&mut train(root, "it's my run", &[]))), ["volseggs", "eval", &run]);
    for (arguments, words) in [
        (vec!["segment", "list", &run], vec!["volseggs", "segment", "coarse", &run]),
        (vec!["render", &run, "--show", "segments", "--out", "x"], vec!["volseggs", "segment", "coarse", &run]),
        (vec!["compare", &run], vec!["volseggs", "eval", &run]),
    ] {
        let said = said(volseggs().current_dir(root).args(&arguments));
        assert_eq!(suggested(&said), words, "{said}");
    }
}
