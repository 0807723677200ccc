//! The extension points, with the examples of `docs/research.md`: registered, trained, saved, evaluated.
#![allow(clippy::unwrap_used)]

mod common;

#[path = "../examples/extended/densification.rs"]
mod densification;
#[path = "../examples/extended/encoder.rs"]
mod encoder;
#[path = "../examples/extended/exporter.rs"]
mod exporter;
#[path = "../examples/extended/loss.rs"]
mod loss;
#[path = "../examples/extended/metric.rs"]
mod metric;
#[path = "../examples/extended/schedule.rs"]
mod schedule;

use common::{SETTINGS, dataset, json, text, train_arguments};
use std::path::Path;
use volseggs::burn::tensor::{Device, Tensor, TensorData};
use volseggs::cli::Cli;
use volseggs::config::types::{Config, OptimConfig};
use volseggs::data::{Dataset, OpenOptions};
use volseggs::device::DeviceName;
use volseggs::extend::{
    self, EncoderDefinition, LossInput, LossTerm, Metric, MetricInput, Networks, Parameters, Schedule,
};
use volseggs::model::Scene;
use volseggs::model::ToKernel;
use volseggs::model::params::{collect, to_vec};
use volseggs::rng::{Purpose, Rng};
use volseggs::train::schedule::{Stage, learning_rate};
use volseggs::train::{TrainError, Trainer};

/// The same names as in the example program; registering twice does no harm.
fn register() {
    extend::loss_term("edges", loss::Edges);
    extend::encoder("waves", encoder::Waves { frequency: 3.0 });
    extend::encoder("fast-waves", encoder::Waves { frequency: 9.0 });
    extend::schedule("warm-cosine", schedule::WarmCosine { warm: 0.05, last: 0.01 });
    extend::densification("opaque", densification::Opaque { opacity: 0.1 });
    extend::metric("foreground_psnr", metric::ForegroundPsnr);
    extend::exporter(exporter::XYZ);
}

fn config(more: &[&str]) -> Config {
    register();
    let settings = SETTINGS.iter().chain(more).map(|s| (*s).to_owned());
    volseggs::method::layers().source("best").sets(settings).resolve::<Config>().unwrap().value
}

fn open(root: &Path) -> Dataset {
    Dataset::open(&root.join("data"), &OpenOptions::default()).unwrap()
}

fn device() -> Device {
    DeviceName::all()[0].open().unwrap()
}

/// Returns a trainer after `steps` steps, and its losses.
fn trained(data: &Dataset, config: Config, steps: usize) -> (Trainer, Vec<f64>) {
    let mut trainer = Trainer::new(config, data, &device()).unwrap();
    let losses = (0..steps).map(|_| trainer.step(&data.train).unwrap().loss).collect();
    (trainer, losses)
}

/// Returns the largest difference between the gradient of `f` at `x` and central differences, over every `every`th
/// value of `x`, as a fraction of the largest gradient.
fn differences<const D: usize>(x: &Tensor<D>, every: usize, f: impl Fn(Tensor<D>) -> Tensor<1>) -> f64 {
    const STEP: f32 = 1e-2;
    let leaf = x.clone().detach().require_grad();
    let gradients = f(leaf.clone()).backward();
    let gradient = to_vec(leaf.grad(&gradients).unwrap());
    let largest = gradient.iter().fold(0.0f32, |a, g| a.max(g.abs()));
    assert!(largest > 0.0 && gradient.iter().all(|g| g.is_finite()), "the gradient is zero or not finite");
    let values = to_vec(x.clone());
    let moved = |i: usize, by: f32| {
        let mut values = values.clone();
        values[i] += by;
        f(Tensor::from_data(TensorData::new(values, x.dims()), &x.device())).into_scalar::<f32>()
    };
    let error = |i: usize| f64::from((moved(i, STEP) - moved(i, -STEP)) / (2.0 * STEP) - gradient[i]).abs();
    (0..values.len()).step_by(every).map(error).fold(0.0, f64::max) / f64::from(largest)
}

fn noise<const D: usize>(shape: [usize; D], seed: u64, device: &Device) -> Tensor<D> {
    let mut rng = Rng::new(seed, 0, Purpose::Custom(0));
    let values: Vec<f32> = (0..shape.iter().product()).map(|_| rng.uniform()).collect();
    Tensor::from_data(TensorData::new(values, shape), device)
}

#[test]
fn the_page_quotes_the_example_files() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |path: &str| std::fs::read_to_string(root.join(path)).unwrap();
    let page = read("docs/research.md");
    for name in ["main", "loss", "encoder", "schedule", "densification", "metric", "exporter", "method"] {
        let path = format!("examples/extended/{name}.rs");
        assert!(page.contains(&format!("```rust\n{}```\n", read(&path))), "docs/research.md does not show {path}");
    }
}

#[test]
fn an_unregistered_name_is_refused_and_the_registered_ones_are_listed() {
    let root = dataset();
    let data = open(root.path());
    let cases: &[(&[&str], &[&str])] = &[
        (&["loss.extra.edgs=0.1"], &["loss.extra", "edgs", "edges"]),
        (&["loss.extra.edgs=0"], &["loss.extra", "edgs", "edges"]),
        (&["loss.extra.edges=-1"], &["loss.extra.edges", "0 or above"]),
        (&["model.encoder=hash"], &["model.encoder", "hash", "factorised, hexplane, implicit, fast-waves, waves"]),
        (&["densify.mode=opaqe"], &["densify.mode", "opaqe", "budget, threshold, relocate, off, opaque"]),
        (&["optim.schedule=cosin"], &["optim.schedule", "cosin", "warm-cosine", "log-linear, cosine, constant, "]),
        (&["model.encoder=waves", "speed.cull_visits=4"], &["speed.cull_visits", "factorised"]),
    ];
    for (settings, words) in cases {
        match Trainer::new(config(settings), &data, &device()) {
            Err(TrainError::Config(text)) => {
                assert!(words.iter().all(|w| text.contains(w)), "{settings:?}: {text}");
            }
            other => panic!("{settings:?}: {:?}", other.map(|_| ())),
        }
    }
}

#[test]
fn a_schedule_with_a_non_finite_factor_is_refused() {
    struct Broken;
    impl Schedule for Broken {
        fn factor(&self, progress: f64, _: &OptimConfig) -> f64 {
            1.0 / (progress - 0.5)
        }
    }
    extend::schedule("broken", Broken);
    let root = dataset();
    let refused = Trainer::new(config(&["optim.schedule=broken"]), &open(root.path()), &device()).unwrap_err();
    assert!(refused.to_string().contains("\"broken\" gives a factor of"), "{refused}");
}

#[test]
fn the_loss_term_has_the_right_gradient_and_changes_the_result() {
    let root = dataset();
    let data = open(root.path());
    let (trainer, without) = trained(&data, config(&[]), 30);
    let (edged, with) = trained(&data, config(&["loss.extra.edges=0.5"]), 30);
    let (_, zero) = trained(&data, config(&["loss.extra.edges=0"]), 30);
    assert_eq!(without, zero, "a weight of 0 disables the term");
    assert!(with[0] > without[0], "{} {}", with[0], without[0]);
    assert!(with.iter().all(|v| v.is_finite()) && with[29] < with[0], "{with:?}");
    assert_ne!(collect(trainer.scene())["gaussians.sh"], collect(edged.scene())["gaussians.sh"]);

    let scene = trainer.scene();
    let gaussians = scene.deformed(0.5);
    let target = noise([7, 9, 4], 1, trainer.device());
    let config = config(&[]);
    let f = |image: Tensor<3>| {
        let (camera, stage, step, time) = (&data.train.frames[0].camera, Stage::Joint(0), 0, 0.5);
        let config = &config;
        loss::Edges.loss(&LossInput {
            image: &image,
            target: &target,
            scene,
            gaussians: &gaussians,
            camera,
            config,
            stage,
            step,
            time,
        })
    };
    let error = differences(&noise([7, 9, 4], 2, trainer.device()), 1, f);
    assert!(error < 0.01, "{error}");
    let equal = f(target.clone()).into_scalar::<f32>();
    assert_eq!(equal, 0.0, "equal images have equal edges");
}

#[test]
fn the_encoder_has_the_right_gradients() {
    let waves = encoder::Waves { frequency: 3.0 };
    let model = config(&[]).model;
    let device = device().autodiff();
    let start = |seed: u64| waves.parameters(&model, &mut Rng::new(seed, 0, Purpose::Custom(0)));
    assert_eq!(start(1), start(1));
    assert_ne!(start(1), start(2));
    let parameters = Parameters::start(start(1), &device);
    let f = |points: Tensor<2>| waves.forward(&parameters, points, 0.3).powi_scalar(2).mean();
    let error = differences(&noise([20, 3], 3, &device), 1, f);
    assert!(error < 0.02, "{error}");
    let at = |time: f32| to_vec(waves.forward(&parameters, noise([20, 3], 3, &device), time));
    assert_ne!(at(0.0), at(1.0));
}

#[test]
fn the_encoder_trains_and_is_restored_from_its_file() {
    let root = dataset();
    let data = open(root.path());
    // the default rates are meant for thousands of steps
    let rates = ["optim.encoder=0.005", "optim.decoder=0.01", "optim.final_fraction=0.3", "loss.dssim=0"];
    let which = ["model.encoder=waves", "stages.joint_steps=280"];
    let settings: Vec<&str> = which.into_iter().chain(rates).collect();
    let (trainer, losses) = trained(&data, config(&settings), 300);
    let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
    let (first, last) = (mean(&losses[20..44]), mean(&losses[276..300]));
    assert!(last < 0.6 * first, "joint training: {first}, then {last}");

    let learnt = collect(trainer.scene());
    let names: Vec<&String> = learnt.keys().filter(|n| n.starts_with("field.encoder")).collect();
    assert_eq!(names, [0, 1, 2].map(|k| format!("field.encoder.Extra.values.{k}")).iter().collect::<Vec<_>>());
    let fresh = Trainer::new(config(&settings), &data, &device()).unwrap();
    for name in names {
        assert_ne!(learnt[name], collect(fresh.scene())[name], "{name} is not trained");
    }

    let path = root.path().join("scene.safetensors");
    trainer.scene().save(&path).unwrap();
    let mut loaded = Scene::load(&path, &device()).unwrap();
    assert_eq!(loaded.spec, trainer.scene().spec);
    let camera = data.train.frames[3].camera.to_kernel();
    assert_eq!(loaded.render(camera, 0.4), trainer.scene().render(camera, 0.4));
    assert_ne!(loaded.render(camera, 0.4), loaded.render(camera, 0.9), "nothing moves");

    // in a program that does not know the encoder
    loaded.spec.model.encoder = "gone".to_owned();
    loaded.save(&path).unwrap();
    let error = Scene::load(&path, &device()).unwrap_err().to_string();
    assert!(["scene.safetensors", "\"gone\"", "waves"].iter().all(|w| error.contains(w)), "{error}");
}

#[test]
fn the_schedule_changes_only_the_decaying_rates() {
    let rates = |schedule: &str, progress: f64| {
        let config = config(&[&format!("optim.schedule={schedule}"), "stages.joint_steps=1000"]);
        let stage = Stage::Joint((1000.0 * progress) as usize);
        let names = ["gaussians.means", "field.encoder.Extra.values.0", "field.decoder.x", "gaussians.rotations"];
        names.map(|name| learning_rate(name, stage, &config, 1.0).unwrap())
    };
    let optim = config(&[]).optim;
    let full = rates("constant", 0.5);
    for progress in [0.0, 0.02, 0.05, 0.3, 0.9] {
        let factor = schedule::WarmCosine { warm: 0.05, last: 0.01 }.factor(progress, &optim);
        let [means, encoder, decoder, rotations] = rates("warm-cosine", progress);
        for (rate, full) in [means, encoder, decoder].iter().zip(&full) {
            assert!((rate / full - factor).abs() < 1e-9, "{progress}: {rate} {full} {factor}");
        }
        assert_eq!(rotations, rates("log-linear", progress)[3]);
    }
    let factor = |p: f64| schedule::WarmCosine { warm: 0.05, last: 0.01 }.factor(p, &optim);
    assert!(
        (factor(0.0) - 0.01).abs() < 1e-12 && (factor(0.05) - 1.0).abs() < 1e-12 && (factor(1.0) - 0.01).abs() < 1e-12
    );
}

#[test]
fn the_densification_rule_follows_the_line_to_the_budget() {
    let root = dataset();
    let data = open(root.path());
    let settings = ["densify.mode=opaque", "densify.budget=240", "densify.every=5", "densify.prune_opacity=0"];
    let spans = ["densify.warmup_from=0", "densify.joint_from=0", "densify.joint_until=30", "stages.joint_steps=40"];
    let few: Vec<&str> = settings.into_iter().chain(spans).chain(["init.points=200", "init.opacity=0.2"]).collect();
    let (trainer, losses) = trained(&data, config(&few), 55);
    assert_eq!(trainer.scene().gaussians.count(), 240);
    assert!(losses.iter().all(|loss| loss.is_finite()));
}

#[test]
fn the_metric_covers_only_the_silhouette() {
    let value = |render: &[f32], alpha: &[f32]| {
        let (width, height, background, time, networks) = (alpha.len(), 1, [1.0; 3], 0.0, &Networks::default());
        let truth = &vec![0.5; render.len()];
        let view = MetricInput { render, truth, alpha, width, height, background, time, networks };
        metric::ForegroundPsnr.value(&view).unwrap()
    };
    let render = [0.6, 0.6, 0.6, 1.0, 1.0, 1.0];
    assert!((value(&render, &[0.3, 0.0]).unwrap() - 20.0).abs() < 1e-4);
    assert!(value(&render, &[0.3, 0.1]).unwrap() < 10.0);
    assert!(value(&render, &[0.0, 0.0]).is_none() && value(&[], &[]).is_none());
    assert_eq!(value(&[0.5; 3], &[1.0]), None);
}

#[test]
fn the_program_accepts_all_extensions() {
    register();
    let root = dataset();
    let settings = ["loss.extra.edges=0.1", "model.encoder=waves", "optim.schedule=warm-cosine"];
    let run = |arguments: Vec<String>| {
        let program = ["volseggs".to_owned()].into_iter().chain(arguments);
        Cli::from_line(program).unwrap().run().unwrap();
    };
    run(train_arguments(root.path(), "run", &settings));
    run(["eval", &text(root.path(), "run")].map(str::to_owned).to_vec());
    let points = text(root.path(), "points.xyz");
    let program = Path::new(env!("CARGO_BIN_EXE_volseggs")).with_file_name("examples").join("extended");
    for _ in 0..2 {
        // the second time, the program replaces its own file
        let export = ["export", &text(root.path(), "run"), "--refit", "0", "--out", &points];
        assert_cmd::Command::new(&program).args(export).assert().success();
    }
    let written = std::fs::read_to_string(&points).unwrap();
    assert!(written.starts_with("# volseggs: x y z opacity\n# coordinates scene\n"), "{written}");
    assert!(written.lines().last().unwrap().split(' ').filter_map(|v| v.parse::<f64>().ok()).count() == 4, "{written}");

    let kept: toml::Table = std::fs::read_to_string(root.path().join("run/config.toml")).unwrap().parse().unwrap();
    assert_eq!(kept["loss"]["extra"]["edges"].as_float(), Some(0.1));
    let eval = root.path().join("run/eval/test");
    let mean = json(&eval.join("mean.json"));
    let foreground = mean["extra"]["foreground_psnr"].as_f64().unwrap();
    assert!(foreground > 3.0 && foreground < mean["psnr"].as_f64().unwrap(), "{mean}");
    let table = std::fs::read_to_string(eval.join("views.csv")).unwrap();
    let mut lines = table.lines();
    assert_eq!(lines.next().unwrap(), "view,time,psnr,ssim,ssim_gray,lpips_alex,lpips_vgg,foreground_psnr");
    let column: Vec<f64> = lines.map(|l| l.rsplit(',').next().unwrap().parse().unwrap()).collect();
    assert_eq!(column.len(), 6);
    assert!((column.iter().sum::<f64>() / 6.0 - foreground).abs() < 1e-4, "{column:?} {foreground}");
}
