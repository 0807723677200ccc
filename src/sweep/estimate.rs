//! What a sweep will take, before it runs: time and memory from the sizes alone, corrected by the runs that are there.
//!
//! The model was fitted to this program's own runs on two cores with AVX2; it is meant to tell minutes from hours.

use super::datasets::DataPlan;
use super::plan::{Plan, Run};
use super::result::{Progress, progress, read};
use crate::config::types::{Config, EncoderKind};
use crate::train::run::RunRecord;

/// Seconds of CPU time that any step takes.
const PER_STEP: f64 = 0.02;
/// More for each Gaussian of a joint step: field, decoder, their gradients, Adam.
const PER_GAUSSIAN: f64 = 2.5e-6;
/// The same in warm-up, where there is no field.
const PER_GAUSSIAN_WARMUP: f64 = 0.9e-6;
/// More for each pixel: splatting and losses.
const PER_PIXEL: f64 = 1.5e-7;
/// More for each pixel while DSSIM counts.
const PER_PIXEL_DSSIM: f64 = 2.0e-7;
/// The implicit encoder beside the factorised one, for each Gaussian.
const IMPLICIT: f64 = 1.6;
/// Part of the cores that a run keeps busy.
const BUSY: f64 = 0.8;

/// What one run will take.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cost {
    /// Seconds of CPU time; of the device's time on a GPU it says nothing.
    pub cpu_seconds: f64,
    /// Peak memory, bytes.
    pub memory: f64,
}

/// What a whole sweep will take.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// Runs that are left to do.
    pub open: usize,
    /// Seconds from now to the end.
    pub seconds: f64,
    /// Memory at its peak, all processes together, bytes.
    pub memory: f64,
    /// Measured over modelled time in finished runs; 1 if there are none.
    pub correction: f64,
}

/// What a run of `config` on `data` will take.
#[must_use]
pub fn cost(config: &Config, data: &DataPlan) -> Cost {
    let factor = f64::from(config.data.downscale.max(1));
    let pixels = f64::from(data.size[0]) * f64::from(data.size[1]) / (factor * factor);
    let growing = config.densify.budget > config.init.points;
    let end = config.densify.budget.max(config.init.points) as f64;
    let n = if growing { 0.5 * (config.init.points as f64 + end) + 0.2 * end } else { end }.min(end);
    let (warm, joint) = (config.stages.warmup_steps as f64, config.stages.joint_steps as f64);
    let encoder = if config.model.encoder == EncoderKind::Factorised { 1.0 } else { IMPLICIT };
    let dssim = if config.loss.dssim > 0.0 { (config.loss.dssim_last as f64).min(joint) } else { 0.0 };
    let cpu_seconds = (joint + warm) * PER_STEP
        + joint * (n * PER_GAUSSIAN * encoder + pixels * PER_PIXEL)
        + warm * (config.init.points as f64 * PER_GAUSSIAN_WARMUP + pixels * PER_PIXEL)
        + dssim * pixels * PER_PIXEL_DSSIM;
    // images as bytes; parameters, gradients, two moments and the tape's copies of each Gaussian; the program itself
    let views = data.views as f64 + if config.output.eval_every > 0 { data.test_views as f64 } else { 0.0 };
    let memory = views * pixels * 4.0 + end * 4.0e3 + 1.5e8;
    Cost { cpu_seconds, memory }
}

/// What is left of `runs`, `jobs` at a time.
#[must_use]
pub fn estimate(plan: &Plan, runs: &[usize], jobs: usize) -> Estimate {
    let cores = std::thread::available_parallelism().map_or(1.0, |n| usize::from(n) as f64);
    let of = |run: &Run| -> Option<Cost> {
        let config: Config = toml::from_str(&run.config).ok()?;
        Some(cost(&config, plan.datasets.get(&run.dataset)?))
    };
    let wall = |cost: Cost| cost.cpu_seconds / (cores * BUSY) * jobs.min(runs.len()).max(1) as f64;
    let mut ratios = Vec::new();
    let (mut seconds, mut memory, mut open) = (0.0, 0.0f64, 0);
    for (i, run) in plan.runs.iter().enumerate() {
        let Some(cost) = of(run) else { continue };
        let record: Option<RunRecord> = read(&plan.run_folder(i).join("run.json"));
        if let Some(record) = record.filter(|r| r.status == "complete") {
            let threads = record.threads as f64;
            ratios.push(record.training_seconds * threads * BUSY / cost.cpu_seconds.max(1e-9));
        }
        if runs.contains(&i) && progress(plan, i) == Progress::Open {
            open += 1;
            seconds += wall(cost) / jobs.max(1) as f64;
            memory = memory.max(cost.memory);
        }
    }
    ratios.sort_by(f64::total_cmp);
    let correction = ratios.get(ratios.len() / 2).copied().unwrap_or(1.0);
    let together = jobs.min(open).max(1) as f64;
    Estimate { open, seconds: seconds * correction, memory: memory * together, correction }
}
