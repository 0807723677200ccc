//! `volseggs train`

use super::{CliError, Common, config::ConfigSource, print_json, stop_flag};
use crate::train::open_dataset;
use crate::train::run::{RunOptions, run};
use clap::Args;
use std::path::PathBuf;

/// Train a scene from posed, timed images.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs train --data DATASET --config quick --out checkpoints/first\n  volseggs train --data DATASET --config best --set loss.dssim=0 --set seed=3 --out checkpoints/no-dssim\n  volseggs train --data DATASET --config best --out checkpoints/first --resume\n\nCtrl-C saves a checkpoint; --resume goes on from the newest one with the same result as if nothing had happened."
)]
pub struct TrainArgs {
    /// Dataset folder with transforms_train.json (and transforms_test.json for live test PSNR).
    #[arg(long, value_name = "DATASET")]
    data: PathBuf,
    #[command(flatten)]
    config: ConfigSource,
    /// Folder of the run; made if it is not there.
    #[arg(long, value_name = "RUN")]
    out: PathBuf,
    /// Go on from the newest checkpoint in RUN.
    #[arg(long)]
    resume: bool,
    /// Stop after this many steps in all, with a checkpoint, as if interrupted.
    #[arg(long, value_name = "STEPS")]
    stop_after: Option<usize>,
    #[command(flatten)]
    common: Common,
}

impl TrainArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (name, device) = self.common.device()?;
        let resolved = self.config.resolve()?;
        let config = resolved.value.clone();
        let dataset = open_dataset(&self.data, &config)?;
        eprintln!(
            "{}: {} training views of {}x{} at {} times; device {name}, {} threads",
            self.data.display(),
            dataset.train.frames.len(),
            dataset.train.images.width,
            dataset.train.images.height,
            dataset.train.times().len(),
            rayon::current_num_threads()
        );
        let stop = stop_flag("stopping after this step, with a checkpoint")?;
        let options = RunOptions {
            out: self.out.clone(),
            resume: self.resume,
            config_toml: resolved.to_toml().map_err(CliError::failure)?,
            device_name: name.to_string(),
            stop_after: self.stop_after,
        };
        let outcome = run(&config, &dataset, &device, &options, &stop)?;
        let r = &outcome.record;
        eprintln!(
            "{} after {} steps, {:.1} min, {} Gaussians, peak memory {:.2} GB{}; next: volseggs eval {}",
            r.status,
            r.steps,
            r.training_seconds / 60.0,
            r.gaussians,
            r.peak_memory_bytes as f64 / 1e9,
            outcome.test_psnr.map(|p| format!(", test PSNR {p:.2} dB on a few views")).unwrap_or_default(),
            self.out.display()
        );
        if self.common.json {
            print_json(r)?;
        }
        if outcome.complete || self.stop_after.is_some() {
            Ok(())
        } else {
            Err(CliError::failure(format!(
                "interrupted; go on with: volseggs train ... --out {} --resume",
                self.out.display()
            )))
        }
    }
}
