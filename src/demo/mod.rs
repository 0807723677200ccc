//! The whole workflow on a synthetic scene: prepare, train, evaluate, segment and track, and a report of it all. Every
//! stage is the library call behind the command of the same name; a stopped demo resumes where it was.

mod segments;
mod story;

use crate::config::RESERVED_VARIABLES;
use crate::config::types::Config;
use crate::data::{Split, SplitName};
use crate::eval::run::Evaluation;
use crate::files::{LockDuration, LockError, RunLock, check_file};
use crate::log::progress;
use crate::method;
use crate::metrics::metric::Networks;
use crate::prepare::views::{TrainingTimes, ViewOptions};
use crate::prepare::{
    PrepareError, PrepareOptions, PrepareRecord, PrepareSource, SegmentOptions, SegmentSteps, image_count, prepare,
};
use crate::run::measure::{MeasuredOn, measure};
use crate::run::{AnyRun, OpenRun};
use crate::train::run::{RunContext, RunOptions, RunOutcome, RunStart};
use crate::train::{TrainError, open_dataset};
use crate::volume::synthetic::Synthetic;
use burn::tensor::Device;
use clap::Args;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;
use thiserror::Error;

/// Field of view of all cameras, radians: narrower than the published 30 degrees, so that the scene fills the frame.
const FOV: f64 = 20.0 * std::f64::consts::PI / 180.0;

/// Options of [`demo`].
#[derive(Args, Clone, Debug)]
pub struct DemoOptions {
    /// Folder for the dataset, the run and report.html.
    #[arg(long, default_value = "checkpoints/demo", value_name = "DIR")]
    pub out: PathBuf,
    /// The scene: jets, vortices, shells, layers, beads or filaments; or FAMILY:SEED, see `volseggs prepare --help`.
    #[arg(long, default_value = "jets", value_name = "NAME")]
    pub scene: Synthetic,
    /// Width and height of the images in pixels; larger images benefit from longer training.
    #[arg(long, default_value_t = 200, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(16..=4096))]
    pub size: u32,
    /// Override a key of the `demo` preset; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

/// The outcome of [`demo`].
#[derive(Debug)]
pub struct DemoOutcome {
    /// The report page.
    pub report: PathBuf,
    /// Metrics on the test views.
    pub evaluation: Evaluation,
    /// Seconds of each stage.
    pub stages: Vec<(String, f64)>,
}

/// Why the demo ended early.
#[derive(Debug, Error)]
pub enum DemoError {
    /// A stage failed; the text is the stage's own.
    #[error("{stage}: {reason}")]
    Stage {
        /// `prepare`, `train`, ...
        stage: &'static str,
        /// Its message.
        reason: String,
    },
    /// The configuration is refused, or training failed.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// The user can fix it: another option, another folder.
    #[error("{0}")]
    Input(String),
    /// Stopped from outside.
    #[error("interrupted; run the same command again to continue")]
    Interrupted,
}

fn failed<E: std::fmt::Display>(stage: &'static str) -> impl FnOnce(E) -> DemoError {
    move |e| DemoError::Stage { stage, reason: e.to_string() }
}

/// Everything that the report covers.
pub(crate) struct Results<'a> {
    options: &'a DemoOptions,
    prepared: PrepareRecord,
    data: PathBuf,
    run: OpenRun,
    outcome: RunOutcome,
    test: Split,
    evaluation: Evaluation,
    segments: segments::SegmentStory,
    stages: Vec<(String, f64)>,
}

/// Names the holder of the run to other processes.
const COMMAND: &str = "volseggs demo";

/// Runs the demo on a device, of which the record of the run gives the name.
///
/// # Errors
/// The stage that failed, or that it was interrupted by `stop`.
pub fn demo(
    options: &DemoOptions,
    (name, device): (&str, &Device),
    stop: &AtomicBool,
) -> Result<DemoOutcome, DemoError> {
    let resolved = method::layers()
        .source("demo")
        .env(std::env::vars_os(), RESERVED_VARIABLES)
        .and_then(|layers| layers.sets(options.set.iter().cloned()).resolve::<Config>())
        .map_err(|e| DemoError::Input(format!("config: {e}")))?;
    method::check(&resolved.value)?;
    if options.out.is_file() {
        return Err(DemoError::Input(format!("{}: is a file; choose another --out", options.out.display())));
    }
    std::fs::create_dir_all(&options.out).map_err(failed("prepare"))?;
    let page = options.out.join("report.html");
    check_file(&page).map_err(|e| DemoError::Input(e.to_string()))?;
    let mut stages = Vec::new();
    let (data, run_folder) = (options.out.join("data"), options.out.join("run"));

    errln!("1/5 prepare: the scene `{}` as images of a volume", options.scene);
    let started = Instant::now();
    let prepared = prepare_stage(options, &data, stop)?;
    stages.push(("prepare".to_owned(), started.elapsed().as_secs_f64()));

    errln!("2/5 train: {} images", prepared.train_views);
    let started = Instant::now();
    let dataset = open_dataset(&data, &resolved.value).map_err(TrainError::Data)?;
    std::fs::create_dir_all(&run_folder).map_err(failed("train"))?;
    let lock = RunLock::acquire(&run_folder, COMMAND, LockDuration::Long).map_err(|e| match e {
        LockError::Held { .. } => DemoError::Input(e.to_string()),
        e => failed("train")(e),
    })?;
    let run_options = RunOptions {
        out: run_folder.clone(),
        start: RunStart::NewOrResume,
        command: COMMAND.into(),
        config_toml: resolved.to_toml().map_err(failed("train"))?,
        device_name: name.to_owned(),
        stop_after: None,
    };
    let context = RunContext { lock: Some(&lock), stop, ..RunContext::new(&resolved.value, &dataset, &run_options) };
    let outcome = method::train(context, device)?;
    if !outcome.reason.is_complete() {
        return Err(DemoError::Interrupted);
    }
    stages.push(("train".to_owned(), started.elapsed().as_secs_f64()));

    errln!("\n3/5 evaluate: {} test views", prepared.test_views);
    let started = Instant::now();
    let trained = AnyRun::open_any(&run_folder, device).map_err(failed("evaluate"))?;
    let on = MeasuredOn::open(&trained, None, SplitName::Test).map_err(failed("evaluate"))?;
    let test = trained.measured(SplitName::Test, None, None).map_err(failed("evaluate"))?;
    let bar = progress::bar(test.frames.len(), "views");
    let folder = trained.paths().eval().join("test");
    let evaluation = measure(&trained, &test, &Networks::default(), &on, &folder, |done, metrics| {
        bar.set_position(done as u64);
        bar.set_message(metrics.headline_text());
    })
    .map_err(failed("evaluate"))?;
    bar.finish_and_clear();
    stages.push(("evaluate".to_owned(), started.elapsed().as_secs_f64()));

    errln!("4/5 segment and track");
    let started = Instant::now();
    let trained = trained.gaussians().map_err(failed("segment"))?;
    let segments = segments::segments(&trained, &data).map_err(failed("segment"))?;
    stages.push(("segment and track".to_owned(), started.elapsed().as_secs_f64()));

    errln!("5/5 report");
    let started = Instant::now();
    let mut results = Results { options, prepared, data, run: trained, outcome, test, evaluation, segments, stages };
    let pictures = story::pictures(&results).map_err(failed("report"))?;
    results.stages.push(("report".to_owned(), started.elapsed().as_secs_f64()));
    let report = story::assemble(&results, pictures).map_err(failed("report"))?;
    report.write(&page).map_err(failed("report"))?;
    Ok(DemoOutcome { report: page, evaluation: results.evaluation, stages: results.stages })
}

/// Renders the dataset, or uses the one left by an earlier run of the demo.
fn prepare_stage(options: &DemoOptions, data: &Path, stop: &AtomicBool) -> Result<PrepareRecord, DemoError> {
    // a voxel is about as large as a pixel
    let voxels = (options.size as usize * 12 / 25).clamp(24, 256);
    let source = PrepareSource::Synthetic { scene: options.scene, dims: [voxels; 3], steps: 60 };
    let plan = PrepareOptions {
        views: ViewOptions {
            size: [options.size; 2],
            fov_x: FOV,
            times: TrainingTimes::Count(20),
            views_per_time: 10,
            test_views: 61,
            ..ViewOptions::default()
        },
        segments: SegmentOptions { views: 7, steps: SegmentSteps::OfViews, label_images: true },
        ..PrepareOptions::default()
    };
    if let Some(record) = PrepareRecord::read(data).map_err(|e| DemoError::Input(e.to_string()))? {
        if record.source == source.describe() && record.size == plan.views.size {
            return Ok(record);
        }
        let ([w, h], data) = (record.size, data.display());
        return Err(DemoError::Input(format!(
            "{data}: holds {} in {w}x{h} pixels, which is not what was requested; choose another --out",
            record.source
        )));
    }
    let transfer = options.scene.transfer_function().map_err(failed("prepare"))?;
    let bar = progress::bar(image_count(&source, &plan), "images");
    let record =
        prepare(&source, &transfer, &plan, data, &|n| bar.set_position(n as u64), stop).map_err(|e| match e {
            PrepareError::Interrupted => DemoError::Interrupted,
            PrepareError::Exists(path) => DemoError::Input(format!(
                "{}: was not made by the demo (there is no prepare.json in it); choose another --out",
                path.display()
            )),
            e @ PrepareError::Memory(_) => DemoError::Input(e.to_string()),
            e => failed("prepare")(e),
        })?;
    bar.finish_and_clear();
    Ok(record)
}
