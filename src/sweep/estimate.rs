//! Estimates what a sweep will take before it runs: time and memory from the sizes alone, corrected by finished runs.
//!
//! The model was fitted to this program's own runs on two cores with AVX2, to distinguish minutes from hours.

use super::builds::OtherBuilds;
use super::datasets::DataPlan;
use super::file::EvalSpec;
use super::plan::{Plan, PlannedRun};
use super::result::{RunCompletion, progress, read, read_segments, segments_path};
use crate::config::types::Config;
use crate::eval::segments::{SegmentEvalOptions, SelectionMethod};
use crate::files::RunPaths;
use crate::method::{self, GaussianWork, MethodWork};
use crate::train::budget::max_gaussians;
use crate::train::losses;
use crate::train::run::RunRecord;
use std::path::Path;

/// Seconds of CPU time that every step takes.
const PER_STEP: f64 = 0.02;
/// Additional seconds for each Gaussian of a joint step: field, decoder, their gradients, Adam.
const PER_GAUSSIAN: f64 = 2.5e-6;
/// The same in warm-up, where there is no field.
const PER_GAUSSIAN_WARMUP: f64 = 0.9e-6;
/// Additional seconds for each pixel: splatting and the distance of the images. Terms of the loss state theirs.
const PER_PIXEL: f64 = 1.5e-7;
/// Additional seconds for each Gaussian of a joint step and each weight of a network: three matrix products.
const PER_WEIGHT: f64 = 1.5e-10;
/// Fraction of the cores that a run keeps busy.
const BUSY: f64 = 0.8;
/// Seconds of CPU time until a run's first step, apart from its images: the process, the plan, the visual hull.
const START: f64 = 1.5;
/// Additional seconds for each pixel of the images: decoding and carving.
const PER_PIXEL_READ: f64 = 1.0e-7;
/// Seconds for each view that is measured at the end or during training.
const PER_VIEW: f64 = 0.01;
/// Additional seconds for each Gaussian in such a view: field, decoder, splatting.
const PER_GAUSSIAN_VIEW: f64 = 1.0e-6;
/// Additional seconds for each of its pixels at the end: PSNR, both SSIM.
const PER_PIXEL_VIEW: f64 = 2.0e-6;
/// Additional seconds for each of its pixels and each LPIPS network.
const PER_PIXEL_LPIPS: f64 = 1.5e-5;
/// Seconds for each pixel of a synthetic dataset that is still to be rendered.
const PER_PIXEL_RENDERED: f64 = 3.0e-6;
/// Seconds for each training step of an affinity field and each Gaussian, with [`FINE_PIXELS`] pixels. What is about
/// segments was measured with 12,000 Gaussians and 30 views of 240x240, 1500 steps of a field and 500 of SAGA.
const PER_FINE: f64 = 80.0 / (1500.0 * 12_000.0);
/// The same within the clicked colour.
const PER_FINE_COLOUR: f64 = 26.0 / (1500.0 * 12_000.0);
/// Pixels of a step that these were measured with.
const FINE_PIXELS: f64 = 2048.0;
/// The same for each step of SAGA.
const PER_SAGA: f64 = 100.0 / (500.0 * 12_000.0);
/// Seconds for each pixel of the views with masks: the masks, and the clicks.
const PER_PIXEL_MASKS: f64 = 15.0 / (30.0 * 240.0 * 240.0);
/// Additional seconds for each of these pixels: the oracle.
const PER_PIXEL_ORACLE: f64 = 20.0 / (30.0 * 240.0 * 240.0);
/// Seconds for the report at the end.
const REPORT: f64 = 2.0;

/// Seconds for each multiply-add of a network; the backward pass takes two for each of the forward pass.
const PER_PRODUCT: f64 = PER_WEIGHT / 3.0;

/// Estimated cost of one run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RunCost {
    /// Seconds of CPU time of the steps; does not account for the device's time on a GPU.
    pub cpu_seconds: f64,
    /// Seconds of CPU time before and after them: start, images, evaluation.
    pub around: f64,
    /// Peak memory in bytes.
    pub memory: f64,
}

/// Estimated cost of a whole sweep.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SweepEstimate {
    /// Number of runs left to do.
    pub open: usize,
    /// Seconds from now to the end.
    pub seconds: f64,
    /// Peak memory of all processes together, in bytes.
    pub memory: f64,
    /// Ratio of measured to modelled time in finished runs; 1 if there are none.
    pub correction: f64,
}

/// Estimates the cost of a run of `config` on `data`, measured as `eval` specifies.
pub fn cost(config: &Config, data: &DataPlan, eval: &EvalSpec) -> RunCost {
    let factor = f64::from(config.data.downscale.max(1));
    let pixels = f64::from(data.size[0]) * f64::from(data.size[1]) / (factor * factor);
    let method = method::find(&config.method).ok();
    let of = match method.and_then(|method| Some((method.steps(config) as f64, method.work(config)?))) {
        Some((steps, MethodWork::Network { step, pixel, bytes })) => of_network(steps, [step, pixel], bytes, pixels),
        Some((_, MethodWork::Gaussians(work))) => of_gaussians(config, work, pixels),
        None => of_gaussians(config, GaussianWork::of_the_field(&config.model), pixels),
    };
    let views = data.views as f64 + if config.output.eval_every > 0 { data.test_views as f64 } else { 0.0 };
    let measured = eval.views.unwrap_or(data.test_views).min(data.test_views) as f64;
    let live = match config.output.eval_every {
        0 => 0.0,
        every => of.steps / every as f64 * config.output.eval_views.min(data.test_views) as f64,
    };
    let lpips = eval.lpips_weights.len() as f64;
    let around = START
        + (views + measured) * pixels * PER_PIXEL_READ
        + (measured + live) * (PER_VIEW + of.view + pixels * PER_PIXEL)
        + measured * pixels * (PER_PIXEL_VIEW + lpips * PER_PIXEL_LPIPS);
    let max_cpu_seconds = match config.output.max_minutes {
        0.0 => f64::INFINITY,
        minutes => 60.0 * minutes * cores() * BUSY,
    };
    // images as bytes; the program itself
    let memory = of.memory + views * pixels * 4.0 + 1.5e8;
    RunCost { cpu_seconds: of.cpu_seconds.min(max_cpu_seconds), around, memory }
}

/// The part of the cost that depends on the method.
struct MethodCost {
    steps: f64,
    cpu_seconds: f64,
    /// Seconds of CPU time per view, without what every view takes.
    view: f64,
    memory: f64,
}

fn of_network(steps: f64, [per_step, per_pixel]: [f64; 2], bytes: f64, pixels: f64) -> MethodCost {
    MethodCost {
        steps,
        // the backward pass takes twice as long as the forward pass
        cpu_seconds: steps * (PER_STEP + 3.0 * per_step * PER_PRODUCT),
        view: pixels * per_pixel * PER_PRODUCT,
        memory: bytes,
    }
}

fn of_gaussians(config: &Config, work: GaussianWork, pixels: f64) -> MethodCost {
    let (start, end) = (config.init.points as f64, max_gaussians(config) as f64);
    let n = if end > start { 0.5 * (start + end) + 0.2 * end } else { end }.min(end);
    let (warm, joint) = (config.stages.warmup_steps as f64, config.stages.joint_steps as f64);
    let products = work.products * PER_WEIGHT;
    let per_warmup = if work.in_warmup { PER_GAUSSIAN } else { PER_GAUSSIAN_WARMUP };
    // without a joint stage, Gaussians grow in warm-up
    let warm_n = if joint > 0.0 { start } else { n };
    let cpu_seconds = (joint + warm) * PER_STEP
        + joint * (n * (PER_GAUSSIAN * work.field + products) + pixels * PER_PIXEL)
        + warm * (warm_n * per_warmup + pixels * PER_PIXEL)
        + pixels * losses::seconds_per_pixel(config);
    // parameters, gradients, two moments and the tape's copies of each Gaussian
    let memory = end * (4.0e3 + work.kept * 4.0);
    MethodCost { steps: warm + joint, cpu_seconds, view: end * (PER_GAUSSIAN_VIEW + products / 3.0), memory }
}

/// Estimates the seconds of CPU time that segments of a run of `config` on `data` take, measured as `spec` specifies.
fn segmentation(spec: &SegmentEvalOptions, config: &Config, data: &DataPlan) -> f64 {
    let affinity = spec.config().affinity;
    let (fine, saga) = (affinity.steps as f64 * affinity.pixels as f64 / FINE_PIXELS, spec.saga_steps as f64);
    let per_gaussian = spec.methods.iter().map(|method| match method {
        SelectionMethod::Fine => fine * PER_FINE,
        SelectionMethod::CoarseFine => fine * PER_FINE_COLOUR,
        SelectionMethod::Saga => saga * PER_SAGA,
        // colours and votes are not trained
        SelectionMethod::Coarse | SelectionMethod::Sagd => 0.0,
    });
    let per_gaussian: f64 = per_gaussian.sum();
    let pixels = spec.views as f64 * f64::from(data.size[0]) * f64::from(data.size[1]);
    let oracle = if spec.oracle { PER_PIXEL_ORACLE } else { 0.0 };
    max_gaussians(config) as f64 * per_gaussian + pixels * (PER_PIXEL_MASKS + oracle)
}

fn cores() -> f64 {
    std::thread::available_parallelism().map_or(1.0, |n| usize::from(n) as f64)
}

/// Estimates what is left of `runs`, `jobs` at a time; failed runs count if they are tried again (`retry`).
pub fn estimate(plan: &Plan, runs: &[usize], jobs: usize, retry: bool) -> SweepEstimate {
    let cores = cores();
    // its cost, and that of its segments that are not measured yet
    let of = |i: usize, run: &PlannedRun| -> Option<(RunCost, f64)> {
        let config: Config = toml::from_str(&run.config).ok()?;
        let data = plan.datasets.get(&run.dataset)?;
        let left = run.segments.iter().filter(|spec| read_segments(&segments_path(plan, i, spec)).is_none());
        let segments = left.map(|spec| segmentation(spec, &config, data)).sum();
        Some((cost(&config, data, &plan.eval), segments))
    };
    // processes share the cores, so running several at a time takes as long as one after the other
    let wall = |cpu_seconds: f64| cpu_seconds / (cores * BUSY);
    let mut ratios = Vec::new();
    // another build's times are better than none
    let others = OtherBuilds::find(plan);
    let record = |folder: &Path| read::<RunRecord>(&RunPaths(folder).record()).filter(|r| r.status == "complete");
    let (mut seconds, mut around, mut memory, mut open) = (0.0, 0.0, 0.0f64, 0);
    for (i, run) in plan.runs.iter().enumerate() {
        let Some((cost, segments)) = of(i, run) else { continue };
        let of_others = || others.of_run(i).first().and_then(|key| record(&plan.runs_folder.join(key)));
        let own = record(&plan.run_folder(i));
        let trained = own.is_some();
        if let Some(record) = own.or_else(of_others) {
            let threads = record.threads as f64;
            ratios.push(record.training_seconds * threads * BUSY / cost.cpu_seconds.max(1e-9));
        }
        let is_open = match progress(plan, i) {
            RunCompletion::Done => false,
            RunCompletion::Failed(_) => retry,
            RunCompletion::Open => true,
        };
        if runs.contains(&i) && is_open {
            open += 1;
            // what is trained is only measured
            seconds += if trained { 0.0 } else { wall(cost.cpu_seconds) };
            around += wall(cost.around + segments);
            memory = memory.max(cost.memory);
        }
    }
    ratios.sort_by(f64::total_cmp);
    let correction = ratios.get(ratios.len() / 2).copied().unwrap_or(1.0);
    let together = jobs.min(open).max(1) as f64;
    if open > 0 {
        let images = |d: &DataPlan| {
            let all = d.views + d.test_views + d.segment_images();
            all as f64 * f64::from(d.size[0]) * f64::from(d.size[1])
        };
        let rendered = plan.datasets.values().filter(|d| !d.folder.is_dir()).map(images).sum::<f64>();
        around += REPORT + wall(rendered * PER_PIXEL_RENDERED);
    }
    SweepEstimate { open, seconds: seconds * correction + around, memory: memory * together, correction }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::method::preset;
    use crate::sweep::PlanOptions;
    use crate::sweep::key::{key, parts};
    use crate::sweep::result::{write, write_measured};

    fn plan(seeds: &str, test_views: usize) -> Plan {
        plan_in(tempfile::tempdir().unwrap().path(), seeds, test_views)
    }

    fn plan_in(dir: &Path, seeds: &str, test_views: usize) -> Plan {
        let path = dir.join("short.toml");
        let text = format!(
            "config = 'demo'\nseeds = {seeds}\nset = {{ 'stages.warmup_steps' = 1, 'stages.joint_steps' = 1 }}\n[data]\n\
             jets = {{ synthetic = 'jets', size = 100, times = 3, views = 4, test_views = {test_views} }}\n"
        );
        std::fs::write(&path, text).unwrap();
        Plan::new(&path, &PlanOptions { out: dir.to_owned(), ..PlanOptions::default() }).unwrap()
    }

    #[test]
    fn times_of_another_build_correct_the_estimate_but_its_runs_are_still_to_do() {
        let dir = tempfile::tempdir().unwrap();
        let plan = plan_in(dir.path(), "[0, 1]", 5);
        let of = |runs: &[usize]| estimate(&plan, runs, 1, false);
        assert_eq!(of(&[0, 1]).correction, 1.0);
        let folder = plan.runs_folder.join(key(parts(&plan.runs[0].key).0, "aaaaaaaaaaaaaaaa"));
        std::fs::create_dir_all(folder.join("checkpoints/step-000002")).unwrap();
        std::fs::write(folder.join("checkpoints/step-000002/state.json"), "{}").unwrap();
        let mut record =
            RunRecord { status: "complete".into(), threads: 2, training_seconds: 1e3, ..RunRecord::default() };
        write(&folder.join("run.json"), &record).unwrap();
        assert!(of(&[0, 1]).correction > 2.0 && of(&[0, 1]).open == 2);
        // its own times take precedence
        let own = plan.run_folder(0);
        std::fs::create_dir_all(&own).unwrap();
        record.training_seconds = 1e4;
        let before = of(&[0, 1]).correction;
        write(&own.join("run.json"), &record).unwrap();
        assert!((of(&[0, 1]).correction / before - 10.0).abs() < 1e-6);
    }

    #[test]
    fn a_run_that_is_trained_but_not_measured_takes_no_training() {
        let dir = tempfile::tempdir().unwrap();
        let plan = plan_in(dir.path(), "[0]", 5);
        let before = estimate(&plan, &[0], 1, false);
        std::fs::create_dir_all(plan.run_folder(0)).unwrap();
        let record = RunRecord { status: "complete".into(), threads: 2, training_seconds: 1e4, ..RunRecord::default() };
        write(&plan.run_folder(0).join("run.json"), &record).unwrap();
        let after = estimate(&plan, &[0], 1, false);
        assert_eq!((before.open, after.open), (1, 1), "it is still to be measured");
        assert!(after.correction > 100.0 && after.seconds < before.seconds && after.seconds > REPORT, "{after:?}");
    }

    #[test]
    fn segments_cost_as_measured_until_they_are_done() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("parts.toml");
        let text = "config = 'demo'\n[segments]\nmethod = 'fine'\n[data]\njets = { synthetic = 'jets', \
                    segments = true, size = 240, times = 3, views = 4, test_views = 5 }\n";
        std::fs::write(&path, text).unwrap();
        let plan = Plan::new(&path, &PlanOptions { out: dir.path().to_owned(), ..PlanOptions::default() }).unwrap();
        let config: Config = toml::from_str(&plan.runs[0].config).unwrap();
        let data = plan.datasets.values().next().unwrap();
        let n = max_gaussians(&config) as f64 / 12_000.0;
        for (method, oracle, expected) in [
            (SelectionMethod::CoarseFine, false, 26.0 * n + 15.0),
            (SelectionMethod::Fine, true, 80.0 * n + 35.0),
            (SelectionMethod::Saga, false, 100.0 * n + 15.0),
            (SelectionMethod::Coarse, true, 35.0),
        ] {
            let steps = SegmentEvalOptions {
                fine_steps: Some(1500),
                saga_steps: 500,
                views: 30,
                ..SegmentEvalOptions::default()
            };
            let found = segmentation(&SegmentEvalOptions { methods: vec![method], oracle, ..steps }, &config, data);
            assert!((found - expected).abs() < 1e-6 * expected, "{found} {expected}");
        }
        let spec = &plan.runs[0].segments[0];
        let before = seconds(&plan);
        std::fs::create_dir_all(plan.run_folder(0)).unwrap();
        write_measured(&segments_path(&plan, 0, spec), std::collections::BTreeMap::<String, f64>::new()).unwrap();
        let saved = before - seconds(&plan);
        let expected = segmentation(spec, &config, data) / (cores() * BUSY);
        assert!((saved - expected).abs() < 1e-6 * expected, "{saved} {expected}");
    }

    fn seconds(plan: &Plan) -> f64 {
        estimate(plan, &(0..plan.runs.len()).collect::<Vec<_>>(), 1, false).seconds
    }

    #[test]
    fn the_implicit_encoder_takes_as_long_and_as_much_memory_as_its_layers() {
        let plan = plan("[0]", 5);
        let data = plan.datasets.values().next().unwrap();
        let mut config = preset("best").unwrap();
        let hybrid = cost(&config, data, &plan.eval);
        config.model.encoder = "implicit".into();
        let implicit = cost(&config, data, &plan.eval);
        config.model.implicit_width /= 2;
        let half = cost(&config, data, &plan.eval);
        assert!(implicit.cpu_seconds > 3.0 * half.cpu_seconds && half.cpu_seconds > hybrid.cpu_seconds);
        assert!(implicit.around > half.around && half.around > hybrid.around);
        assert!(implicit.memory > 1.5 * half.memory && half.memory > hybrid.memory);
    }

    #[test]
    fn fourdgs_costs_more_than_static_gaussians_and_has_no_encoder() {
        let plan = plan("[0]", 5);
        let data = plan.datasets.values().next().unwrap();
        let preset = method::layers().source("4dgs-small");
        let mut config = preset.resolve::<Config>().unwrap().value;
        let in_time = cost(&config, data, &plan.eval);
        config.model.levels *= 2;
        assert_eq!(cost(&config, data, &plan.eval), in_time, "it has no encoder");
        (config.method, config.sections) = (Config::default().method, Config::default().sections);
        assert!(in_time.cpu_seconds > 1.2 * cost(&config, data, &plan.eval).cpu_seconds, "{in_time:?}");
    }

    #[test]
    fn network_methods_cost_their_products_up_to_the_time_limit() {
        let plan = plan("[0]", 5);
        let data = plan.datasets.values().next().unwrap();
        let of = |name: &str, edit: fn(&mut Config)| {
            let mut config = method::layers().source(name).resolve::<Config>().unwrap().value;
            edit(&mut config);
            cost(&config, data, &plan.eval)
        };
        for name in ["coordnet", "insitunet", "visnerf"] {
            let (small, published) = (of(&format!("{name}-small"), |_| ()), of(name, |_| ()));
            assert!(published.cpu_seconds > 100.0 * small.cpu_seconds, "{name}: {small:?} {published:?}");
            assert!(small.cpu_seconds > 10.0 && small.cpu_seconds < 3600.0, "{name}: {small:?}");
            assert!(
                published.memory > small.memory && published.around > small.around,
                "{name}: {small:?} {published:?}"
            );
            let limited = of(name, |config| config.output.max_minutes = 10.0);
            assert!((limited.cpu_seconds - 600.0 * cores() * BUSY).abs() < 1e-6, "{name}: {limited:?}");
        }
    }

    #[test]
    fn short_runs_include_start_evaluation_and_report() {
        let cores = cores();
        let (one, four) = (seconds(&plan("[0]", 5)), seconds(&plan("[0, 1, 2, 3]", 5)));
        assert!(one > REPORT + START / cores, "{one}");
        assert!(four - one > 3.0 * START / cores, "{one} {four}");
        assert!(seconds(&plan("[0]", 500)) > one + 495.0 * PER_VIEW / cores);
        assert_eq!(estimate(&plan("[0]", 5), &[], 1, false).seconds, 0.0, "nothing is left to do");
    }
}
