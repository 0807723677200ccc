//! Methods behind their interface: one without Gaussians is trained, stopped, resumed, measured and drawn by what serves all
//! methods, and refused by name where Gaussians are needed.
#![allow(clippy::unwrap_used)]

mod common;

#[path = "../examples/extended/method.rs"]
mod method;

use clap::Parser;
use common::{dataset, json, metrics, names, newest_bytes, refused, text, train, volseggs};
use std::path::Path;
use std::sync::atomic::AtomicBool;
use volseggs::cli::Cli;
use volseggs::config::PRESETS;
use volseggs::config::layers::Layers;
use volseggs::config::types::Config;
use volseggs::device::DeviceName;
use volseggs::extend;
use volseggs::metrics::psnr::psnr;
use volseggs::run::{AnyRun, OpenRun};
use volseggs::train::observer::Nobody;
use volseggs::train::open_dataset;
use volseggs::train::run::{RunOptions, RunOutcome, Start};

const SETTINGS: [&str; 7] = [
    "method=pixels",
    "method_settings.steps=60",
    "method_settings.width=24",
    "method_settings.rate=0.05",
    "output.log_every=10",
    "output.eval_every=30",
    "output.checkpoint_every=20",
];

fn resolved(more: &[&str]) -> (Config, String) {
    extend::network("pixels", method::Pixels);
    let sets = SETTINGS.iter().chain(more).map(|s| (*s).to_owned());
    let resolved = Layers::new(PRESETS).sets(sets).resolve::<Config>().unwrap();
    (resolved.value.clone(), resolved.to_toml().unwrap())
}

/// Trains `root/NAME` until the end, or until some step.
fn trained(root: &Path, name: &str, start: Start, stop_after: Option<usize>, more: &[&str]) -> RunOutcome {
    let (config, config_toml) = resolved(more);
    let device = DeviceName::all()[0].open().unwrap();
    let data = open_dataset(&root.join("data"), &config).unwrap();
    let (out, command, device_name) = (root.join(name), "test".to_owned(), "flex".to_owned());
    let options = RunOptions { out, start, command, config_toml, device_name, stop_after };
    volseggs::method::train(&config, &data, &device, &options, None, &AtomicBool::new(false), &mut Nobody).unwrap()
}

/// Runs the program in this process, as the registered method is known here alone: the error and its exit code.
fn told(arguments: &[&str]) -> Result<(), (u8, String)> {
    let cli = Cli::try_parse_from(["volseggs"].iter().chain(arguments)).unwrap();
    cli.run().map_err(|error| (error.code(), error.to_string()))
}

#[test]
fn a_method_without_gaussians_is_trained_measured_and_drawn_by_what_serves_all() {
    let root = dataset();
    let whole = trained(root.path(), "whole", Start::New, None, &[]);
    assert_eq!((whole.complete, whole.record.gaussians, whole.record.method.as_str()), (true, 0, "pixels"));
    let run = root.path().join("whole");
    assert_eq!(names(&run.join("checkpoints")), ["step-000040", "step-000060"]);
    let lines = metrics(&run);
    assert_eq!(lines.iter().map(|l| l["step"].as_u64().unwrap()).collect::<Vec<_>>(), [10, 20, 30, 40, 50, 60]);
    assert!(lines[5]["loss"].as_f64().unwrap() < 0.8 * lines[0]["loss"].as_f64().unwrap(), "{lines:?}");
    assert_eq!((&lines[5]["stage"], &lines[5]["gaussians"]), (&"train".into(), &0.into()));

    // stopped and resumed it is the same
    trained(root.path(), "parts", Start::New, Some(33), &[]);
    trained(root.path(), "parts", Start::Resume, None, &[]);
    let parts = root.path().join("parts");
    assert!(newest_bytes(&parts) == newest_bytes(&run), "a resumed run ends elsewhere");
    assert_eq!(metrics(&parts), lines);

    // measured as any other
    let path = text(root.path(), "whole");
    told(&["eval", &path]).unwrap();
    let mean = json(&run.join("eval/test/mean.json"));
    let parameters = (6 + 1 + 3) * 24 + 3;
    assert_eq!((&mean["gaussians"], &mean["parameters"]), (&0.into(), &parameters.into()));
    let bytes = std::fs::metadata(run.join("checkpoints/step-000060/scene.safetensors")).unwrap().len();
    assert_eq!(mean["model_bytes"], bytes);
    assert!(mean["psnr"].as_f64().unwrap() > 5.0 && mean["fps"].as_f64().unwrap() > 0.0, "{mean}");
    told(&["compare", &path, "--out", &text(root.path(), "table")]).unwrap();

    // drawn as any other
    let frames = text(root.path(), "frames");
    told(&["render", &path, "--path", "orbit", "--frames", "2", "--size", "16", "--out", &frames]).unwrap();
    assert_eq!(json(&root.path().join("frames/frames.json"))["show"], "colour");
    assert!(root.path().join("frames/0001.png").is_file());

    // and refused where Gaussians are needed
    let before = names(&run);
    let (out, ply) = (text(root.path(), "out"), text(root.path(), "out.ply"));
    for arguments in [
        vec!["segment", "coarse", &path],
        vec!["segment", "list", &path],
        vec!["segment", "fine", &path],
        vec!["segment", "masks", &path],
        vec!["segment", "split", &path, "red"],
        vec!["segment", "pick", &path, "--view", "0", "--pixel", "3,3"],
        vec!["track", &path, "--segment", "red"],
        vec!["edit", "isolate", &path, "--segment", "red"],
        vec!["edit", "list", &path],
        vec!["export", &path, "--out", &ply],
        vec!["eval", &path, "--segments"],
        vec!["render", &path, "--show", "depth", "--out", &out],
        vec!["render", &path, "--segment", "red", "--out", &out],
    ] {
        let (code, error) = told(&arguments).unwrap_err();
        assert_eq!(code, 2, "{arguments:?}: {error}");
        assert!(error.contains("the method pixels") && error.contains("Gaussians"), "{arguments:?}: {error}");
        assert_eq!(error.lines().count(), 1, "{error}");
    }
    // as the viewer asks for it
    let error = OpenRun::open(&run, &DeviceName::all()[0].open().unwrap()).unwrap_err();
    assert!(error.is_input() && error.to_string().contains("the method pixels"), "{error}");
    assert_eq!(names(&run), before, "nothing is left behind");
    assert!(!root.path().join("out").exists());
}

#[test]
fn one_image_is_learnt_by_heart() {
    let root = dataset();
    let more = ["data.times=1", "data.views_per_time=1", "method_settings.steps=800", "method_settings.rate=0.005"];
    let more: Vec<&str> = more.into_iter().chain(["output.eval_every=0"]).collect();
    trained(root.path(), "run", Start::New, None, &more);
    let device = DeviceName::all()[0].open().unwrap();
    let run = AnyRun::open_any(&root.path().join("run"), &device).unwrap();
    let data = open_dataset(&root.path().join("data"), &run.config).unwrap();
    assert_eq!(data.train.frames.len(), 1);
    let frame = &data.train.frames[0];
    let drawn = run.model().render(frame.camera.to_kernel(), frame.time as f32);
    let drawn: Vec<f32> = drawn.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    let mut truth = vec![0.0; drawn.len()];
    data.train.images.composite(0, run.model().background(), &mut truth);
    let found = psnr(&drawn, &truth).unwrap();
    assert!(found > 23.0, "{found} dB");
}

#[test]
fn a_run_says_its_method_and_one_that_says_none_is_ours() {
    let root = dataset();
    let run = root.path().join("run");
    train(root.path(), "run", &[]).args(["--method", "volseggs", "--stop-after", "12"]).assert().success();
    assert_eq!(json(&run.join("run.json"))["method"], "volseggs");
    assert!(std::fs::read_to_string(run.join("config.toml")).unwrap().contains("method = \"volseggs\""));
    let mut record = json(&run.join("run.json"));
    record.as_object_mut().unwrap().remove("method");
    std::fs::write(run.join("run.json"), record.to_string()).unwrap();
    let device = DeviceName::all()[0].open().unwrap();
    assert_eq!(OpenRun::open(&run, &device).unwrap().record.method, "volseggs");

    record["method"] = "gone".into();
    std::fs::write(run.join("run.json"), record.to_string()).unwrap();
    refused(volseggs().arg("eval").arg(&run), &["run.json", "there is no method \"gone\"", "volseggs"]);
    let mut other = train(root.path(), "other", &[]);
    refused(other.args(["--method", "gone"]), &["--method", "\"gone\"", "there is", "volseggs"]);
    assert!(!root.path().join("other").exists());
    let mut other = train(root.path(), "other", &["method=gone"]);
    refused(&mut other, &["configuration: method", "\"gone\""]);
    assert!(!root.path().join("other").exists());
}

#[test]
fn a_file_of_another_method_or_of_another_size_is_refused() {
    let root = dataset();
    trained(root.path(), "run", Start::New, Some(2), &[]);
    let run = root.path().join("run");
    let device = DeviceName::all()[0].open().unwrap();
    let mut record = json(&run.join("run.json"));
    record["method"] = "volseggs".into();
    std::fs::write(run.join("run.json"), record.to_string()).unwrap();
    let error = OpenRun::open(&run, &device).unwrap_err().to_string();
    assert!(error.contains("scene.safetensors") && error.contains("not a scene"), "{error}");
    let pixels = volseggs::method::find("pixels").unwrap();
    let scene = root.path().join("ours");
    train(root.path(), "ours", &[]).args(["--stop-after", "2"]).assert().success();
    let (_, checkpoint) = volseggs::train::checkpoint::list(&scene).pop().unwrap();
    let error = pixels.open(&checkpoint.join("scene.safetensors"), &device).unwrap_err().to_string();
    assert!(error.contains("scene.safetensors") && error.contains("another method"), "{error}");
}
