//! Methods behind their common interface: a method without Gaussians is trained, stopped, resumed, evaluated and
//! rendered by the code that serves all methods, and is refused by name where Gaussians are needed.
#![allow(clippy::unwrap_used)]

mod common;

#[path = "../examples/extended/method.rs"]
mod method;

use common::{dataset, json, metrics, names, newest_bytes, refused, text, train, volseggs};
use std::path::Path;
use volseggs::cli::Cli;
use volseggs::config::types::Config;
use volseggs::device::DeviceName;
use volseggs::extend;
use volseggs::metrics::psnr::psnr;
use volseggs::model::ToKernel;
use volseggs::run::{AnyRun, OpenRun};
use volseggs::train::open_dataset;
use volseggs::train::run::{RunContext, RunOptions, RunOutcome, RunStart};
use volseggs::user_error::UserError;

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
    extend::method("pixels", method::Pixels);
    let sets = SETTINGS.iter().chain(more).map(|s| (*s).to_owned());
    let resolved = volseggs::method::layers().source("best").sets(sets).resolve::<Config>().unwrap();
    (resolved.value.clone(), resolved.to_toml().unwrap())
}

/// Trains `root/NAME` to the end, or up to some step.
fn trained(root: &Path, name: &str, start: RunStart, stop_after: Option<usize>, more: &[&str]) -> RunOutcome {
    let (config, config_toml) = resolved(more);
    let device = DeviceName::all()[0].open().unwrap();
    let data = open_dataset(&root.join("data"), &config).unwrap();
    let (out, command, device_name) = (root.join(name), "test".to_owned(), "flex".to_owned());
    let options = RunOptions { out, start, command, config_toml, device_name, stop_after };
    volseggs::method::train(RunContext::new(&config, &data, &options), &device).unwrap()
}

/// Runs the program in this process, as only this process knows the registered method. Returns the exit code and the
/// error.
fn run_in_process(arguments: &[&str]) -> Result<(), (u8, String)> {
    let cli = Cli::from_line(["volseggs"].iter().chain(arguments)).unwrap();
    cli.run().map_err(|error| (error.code(), error.to_string()))
}

#[test]
fn a_method_without_gaussians_is_trained_evaluated_and_rendered_by_the_common_code() {
    let root = dataset();
    let whole = trained(root.path(), "whole", RunStart::New, None, &[]);
    assert_eq!((whole.reason.is_complete(), whole.record.gaussians, whole.record.method.as_str()), (true, 0, "pixels"));
    let run = root.path().join("whole");
    assert_eq!(names(&run.join("checkpoints")), ["step-000040", "step-000060"]);
    let lines = metrics(&run);
    assert_eq!(lines.iter().map(|l| l["step"].as_u64().unwrap()).collect::<Vec<_>>(), [10, 20, 30, 40, 50, 60]);
    assert!(lines[5]["loss"].as_f64().unwrap() < 0.8 * lines[0]["loss"].as_f64().unwrap(), "{lines:?}");
    assert_eq!((&lines[5]["stage"], &lines[5]["gaussians"]), (&"train".into(), &0.into()));

    // stopped and resumed, it is the same
    trained(root.path(), "parts", RunStart::New, Some(33), &[]);
    trained(root.path(), "parts", RunStart::Resume, None, &[]);
    let parts = root.path().join("parts");
    assert!(newest_bytes(&parts) == newest_bytes(&run), "the resumed run has a different result");
    assert_eq!(metrics(&parts), lines);

    // evaluated like any other
    let path = text(root.path(), "whole");
    run_in_process(&["eval", &path]).unwrap();
    let mean = json(&run.join("eval/test/mean.json"));
    let parameters = (6 + 1 + 3) * 24 + 3;
    assert_eq!((&mean["gaussians"], &mean["parameters"]), (&0.into(), &parameters.into()));
    let bytes = std::fs::metadata(run.join("checkpoints/step-000060/scene.safetensors")).unwrap().len();
    assert_eq!(mean["model_bytes"], bytes);
    assert!(mean["psnr"].as_f64().unwrap() > 5.0 && mean["fps"].as_f64().unwrap() > 0.0, "{mean}");
    run_in_process(&["compare", &path, "--out", &text(root.path(), "table")]).unwrap();

    // rendered like any other
    let frames = text(root.path(), "frames");
    run_in_process(&["render", &path, "--path", "orbit", "--frames", "2", "--size", "16", "--out", &frames]).unwrap();
    assert_eq!(json(&root.path().join("frames/frames.json"))["show"], "colour");
    assert!(root.path().join("frames/0001.png").is_file());

    // and refused where Gaussians are needed
    refused_where_gaussians_are_needed(root.path(), "whole", "pixels");
}

#[test]
fn gaussians_in_space_and_time_are_trained_evaluated_rendered_and_refused_by_name() {
    let root = dataset();
    let data = text(root.path(), "data");
    let settings = [
        "init.points=150",
        "stages.warmup_steps=40",
        "stages.sh_every=4",
        "densify.budget=200",
        "densify.every=5",
        "densify.warmup_from=5",
        "densify.warmup_until=30",
        "output.log_every=10",
        "output.eval_every=20",
        "output.eval_views=2",
        "output.checkpoint_every=10",
    ];
    let begin = |name: &str, more: &[&str]| {
        let mut command = volseggs();
        command.args(["train", "--data", &data, "--out", &text(root.path(), name)]);
        command.args(["--method", "4dgs", "--config", "4dgs-small"]);
        command.args(settings.iter().flat_map(|setting| ["--set", setting])).args(more);
        command
    };
    begin("whole", &[]).assert().success();
    let run = root.path().join("whole");
    assert_eq!(json(&run.join("run.json"))["method"], "4dgs");
    assert!(std::fs::read_to_string(run.join("config.toml")).unwrap().contains("[4dgs]"));
    let lines = metrics(&run);
    assert_eq!(lines.last().unwrap()["stage"], "train");

    begin("parts", &["--stop-after", "23"]).assert().success();
    volseggs().args(["train", "--resume", &text(root.path(), "parts")]).assert().success();
    let parts = root.path().join("parts");
    assert!(newest_bytes(&parts) == newest_bytes(&run), "the resumed run has a different result");
    assert_eq!(metrics(&parts), lines);

    let path = text(root.path(), "whole");
    run_in_process(&["eval", &path]).unwrap();
    let mean = json(&run.join("eval/test/mean.json"));
    let gaussians = mean["gaussians"].as_u64().unwrap();
    assert!((100..=200).contains(&gaussians), "{gaussians}");
    assert_eq!(mean["parameters"], gaussians * 53);
    assert!(mean["psnr"].as_f64().unwrap() > 5.0 && mean["fps"].as_f64().unwrap() > 0.0, "{mean}");
    run_in_process(&["compare", &path, "--out", &text(root.path(), "table")]).unwrap();
    let frames = text(root.path(), "frames");
    let orbit = ["--path", "orbit", "--frames", "2", "--size", "16"];
    volseggs().args(["render", &path, "--out", &frames]).args(orbit).assert().success();
    refused_where_gaussians_are_needed(root.path(), "whole", "4dgs");

    refused(&mut begin("more", &["--set", "stages.joint_steps=5"]), &["stages.joint_steps = 5", "the method 4dgs"]);
    refused(&mut begin("more", &["--set", "loss.fade=0.001"]), &["loss.fade = 0.001", "the method 4dgs"]);
    refused(
        &mut begin("more", &["--set", "densify.mode=relocate"]),
        &["densify.mode = \"relocate\"", "the method 4dgs"],
    );
    assert!(!root.path().join("more").exists());
}

/// Checks that everything that needs persistent Gaussians refuses the run `root/NAME` by its method's name and leaves
/// nothing behind.
fn refused_where_gaussians_are_needed(root: &Path, name: &str, method: &str) {
    let words = format!("the method {method},");
    let run = root.join(name);
    let path = text(root, name);
    let before = names(&run);
    let (out, ply) = (text(root, "out"), text(root, "out.ply"));
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
        let (code, error) = run_in_process(&arguments).unwrap_err();
        assert_eq!(code, 2, "{arguments:?}: {error}");
        assert!(error.contains(&words) && error.contains("Gaussians"), "{arguments:?}: {error}");
        assert_eq!(error.lines().count(), 1, "{error}");
    }
    // as the viewer opens it
    let error = OpenRun::open(&run, &DeviceName::all()[0].open().unwrap()).unwrap_err();
    assert!(error.is_input() && error.to_string().contains(&words), "{error}");
    assert_eq!(names(&run), before, "nothing is left behind");
    assert!(!root.join("out").exists());
}

#[test]
fn a_single_image_is_overfitted() {
    let root = dataset();
    let more = ["data.times=1", "data.views_per_time=1", "method_settings.steps=800", "method_settings.rate=0.005"];
    let more: Vec<&str> = more.into_iter().chain(["output.eval_every=0"]).collect();
    trained(root.path(), "run", RunStart::New, None, &more);
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
fn a_run_records_its_method_which_defaults_to_volseggs() {
    let root = dataset();
    let run = root.path().join("run");
    train(root.path(), "run", &[]).args(["--method", "volseggs", "--stop-after", "12"]).assert().success();
    assert_eq!(json(&run.join("run.json"))["method"], "volseggs");
    assert!(std::fs::read_to_string(run.join("config.toml")).unwrap().contains("method = \"volseggs\""));
    let mut record = json(&run.join("run.json"));
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
    trained(root.path(), "run", RunStart::New, Some(2), &[]);
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

/// The built-in methods without Gaussians, with settings for which a step takes milliseconds.
const BUILT_IN: [(&str, &[&str]); 3] = [
    ("coordnet", &["coordnet.widths=[12]", "coordnet.blocks=1", "coordnet.batch=256", "coordnet.steps=6"]),
    (
        "insitunet",
        &[
            "insitunet.channels=[8, 6, 4]",
            "insitunet.critic_channels=[4, 6]",
            "insitunet.encoder=8",
            "insitunet.adversarial=0.01",
            "insitunet.steps=6",
        ],
    ),
    (
        "visnerf",
        &[
            "visnerf.voxels=512",
            "visnerf.width=8",
            "visnerf.batch=64",
            "visnerf.samples_last=16",
            "visnerf.occupancy=8",
            "visnerf.occupancy_every=2",
            "visnerf.steps=6",
        ],
    ),
];

#[test]
fn built_in_methods_without_gaussians_are_trained_resumed_evaluated_rendered_and_refused() {
    let root = dataset();
    let data = text(root.path(), "data");
    for (name, settings) in BUILT_IN {
        let small = format!("{name}-small");
        let begin = |run: &str, more: &[&str]| {
            let mut program = volseggs();
            program.args([
                "train",
                "--data",
                &data,
                "--method",
                name,
                "--config",
                &small,
                "--set",
                "output.eval_every=0",
            ]);
            program.args(settings.iter().flat_map(|set| ["--set", set]));
            program.args(["--out", &text(root.path(), run)]).args(more).assert().success();
        };
        let (whole, parts) = (format!("{name}-whole"), format!("{name}-parts"));
        begin(&whole, &[]);
        begin(&parts, &["--stop-after", "3"]);
        let parts = text(root.path(), &parts);
        volseggs().args(["train", "--resume", &parts]).assert().success();
        let run = root.path().join(&whole);
        assert!(
            newest_bytes(Path::new(&parts)) == newest_bytes(&run),
            "{name}: the resumed run has a different result"
        );
        let record = json(&run.join("run.json"));
        assert_eq!(
            (&record["method"], &record["status"], &record["steps"]),
            (&name.into(), &"complete".into(), &6.into())
        );

        let run = text(root.path(), &whole);
        run_in_process(&["eval", &run, "--views", "2"]).unwrap();
        let mean = json(&Path::new(&run).join("eval/test/mean.json"));
        assert!(mean["psnr"].as_f64().unwrap() > 3.0 && mean["parameters"].as_u64().unwrap() > 100, "{name}: {mean}");
        let frames = text(root.path(), &format!("{name}-frames"));
        let orbit = ["--path", "orbit", "--frames", "1", "--size", "24"];
        volseggs().args(["render", &run]).args(orbit).args(["--out", &frames]).assert().success();
        refused_where_gaussians_are_needed(root.path(), &whole, name);
    }
    let runs = BUILT_IN.map(|(name, _)| text(root.path(), &format!("{name}-whole")));
    let table = text(root.path(), "table");
    run_in_process(&["compare", &runs[0], &runs[1], &runs[2], "--out", &table]).unwrap();
}

#[test]
fn insitunet_without_vgg_weights_reports_it_and_compares_pixels() {
    let root = dataset();
    let mut program = volseggs();
    program.args([
        "train",
        "--data",
        &text(root.path(), "data"),
        "--method",
        "insitunet",
        "--config",
        "insitunet-small",
    ]);
    let features = ["insitunet.perceptual=1", "insitunet.pixel=0"];
    program.args(BUILT_IN[1].1.iter().chain(&features).flat_map(|set| ["--set", set]));
    let output = program.args(["--stop-after", "2", "--out", &text(root.path(), "run")]).assert().success();
    let message = String::from_utf8(output.get_output().stderr.clone()).unwrap();
    assert!(message.contains("note: insitunet.vgg") && message.contains("volseggs lpips --help"), "{message}");
}

#[test]
fn a_run_out_of_time_is_complete_and_continues_with_a_longer_limit() {
    let root = dataset();
    let whole = trained(root.path(), "whole", RunStart::New, None, &[]);
    let short = trained(root.path(), "short", RunStart::New, None, &["output.max_minutes=1e-9"]);
    assert_eq!((short.reason.is_complete(), short.record.status.as_str(), short.record.steps), (true, "complete", 1));
    let run = root.path().join("short");
    assert_eq!(names(&run.join("checkpoints")), ["step-000001"]);
    run_in_process(&["eval", &text(root.path(), "short"), "--views", "1"]).unwrap();
    let again = trained(root.path(), "short", RunStart::Resume, None, &["output.max_minutes=1e-9"]);
    assert_eq!((again.reason.is_complete(), again.record.steps), (true, 1), "no time is left");
    let longer = trained(root.path(), "short", RunStart::Resume, None, &["output.max_minutes=600"]);
    assert_eq!((longer.reason.is_complete(), longer.record.steps), (true, whole.record.steps));
    assert!(newest_bytes(&run) == newest_bytes(&root.path().join("whole")), "the time limit must not affect the steps");
    let refused = volseggs::method::layers().sets(["output.max_minutes=-1"]).resolve::<Config>().unwrap();
    let error = volseggs::train::check_config(&refused.value).unwrap_err().to_string();
    assert!(error.contains("output.max_minutes = -1"), "{error}");
}
