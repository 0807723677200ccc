//! `volseggs train`

#[cfg(feature = "view")]
use super::watch::WatchArgs;
use super::{CliError, CommonArgs, command_line, config::ConfigSource, print_json, stop_flag};
use crate::files::RunPaths;
use crate::method;
use crate::run::dataset_of;
use crate::shell;
use crate::train::run::{RunContext, RunOptions, RunOutcome, RunStart, StopReason, lock_existing};
use crate::train::{advice, checkpoint, open_dataset};
use crate::versioned::Versioned;
use clap::Args;
use std::path::{Path, PathBuf};

/// What follows the options in the help.
fn after_help() -> String {
    // only builds with the viewer have it
    let watch = if cfg!(feature = "view") {
        "  volseggs train --data DATASET --config quick --out checkpoints/first --view   # and watch in a browser\n"
    } else {
        ""
    };
    format!(
        "Examples:\n  volseggs train --data DATASET --config quick --out checkpoints/first\n  volseggs train --data DATASET --config best --set loss.dssim=0 --set seed=3 --out checkpoints/no-dssim\n  volseggs train --resume checkpoints/first                                  # resume\n  volseggs train --resume checkpoints/first --set stages.joint_steps=40000   # train longer\n{watch}\nCtrl-C saves a checkpoint; --resume continues from the newest one, on a CPU with the same result as an uninterrupted training.\nOn resuming, --device, --data (a dataset that was moved), output.*, optim.average and insitunet.vgg may change, and stages.joint_steps may increase: learning rates then follow the new length from there on."
    )
}

/// Train a scene from posed, timed images, with this project's method or another one.
#[derive(Debug, Args)]
#[command(after_help = after_help())]
pub struct TrainArgs {
    /// Dataset folder with transforms_train.json (and transforms_test.json for live test PSNR).
    #[arg(long, value_name = "DATASET", required_unless_present = "resume")]
    data: Option<PathBuf>,
    #[command(flatten)]
    config: ConfigSource,
    /// Folder of the run; created if missing.
    #[arg(long, value_name = "RUN", required_unless_present = "resume")]
    out: Option<PathBuf>,
    /// Resume RUN from its newest checkpoint, or from the checkpoint given; dataset and configuration are the run's.
    #[arg(long, value_name = "RUN", num_args = 0..=1)]
    resume: Option<Option<PathBuf>>,
    /// Stop after this many steps in total, with a checkpoint, as if interrupted.
    #[arg(long, value_name = "STEPS")]
    stop_after: Option<usize>,
    #[command(flatten)]
    common: CommonArgs,
    // a heading stays in force for what follows
    #[cfg(feature = "view")]
    #[command(flatten)]
    watch: WatchArgs,
}

impl TrainArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (name, device) = self.common.device()?;
        let (out, start) = self.place()?;
        let held = lock_existing(&out, &command_line())?;
        #[cfg(feature = "view")]
        let listening = self.watch.listen()?;
        let resolved = match start {
            RunStart::New => {
                if let Some(preset) = self.config.preset_if_none_given() {
                    errln!("no --config: preset {preset}");
                }
                self.config.resolve()?
            }
            _ => self.config.resolve_over(&RunPaths(&out).config())?,
        };
        let data = match &self.data {
            Some(data) => data.clone(),
            None => dataset_of(&out)?,
        };
        let config = resolved.value.clone();
        method::check(&config)?;
        #[cfg(feature = "view")]
        self.watch.check(&config)?;
        let dataset = open_dataset(&data, &config)?;
        errln!(
            "{}: {} training views of {}x{} at {} times; device {name}, {} threads",
            data.display(),
            dataset.train.frames.len(),
            dataset.train.images.width,
            dataset.train.images.height,
            dataset.train.times().len(),
            rayon::current_num_threads()
        );
        if start == RunStart::New {
            advice(&config, dataset.train.frames.len()).iter().for_each(|note| errln!("note: {note}"));
        }
        let stop = stop_flag("stopping after this step, with a checkpoint")?;
        let options = RunOptions {
            out: out.clone(),
            start,
            command: command_line(),
            config_toml: resolved.to_toml().map_err(CliError::failure)?,
            device_name: name.to_string(),
            stop_after: self.stop_after,
        };
        let context = RunContext { lock: held.as_ref(), stop: &stop, ..RunContext::new(&config, &dataset, &options) };
        #[cfg(feature = "view")]
        let outcome = self.watch.train(listening, self.common.json, context, &device)?;
        #[cfg(not(feature = "view"))]
        let outcome = method::train(context, &device)?;
        self.print(&out, &outcome)
    }

    /// The folder of the run, and where to start.
    fn place(&self) -> Result<(PathBuf, RunStart), CliError> {
        match (&self.resume, &self.out) {
            (None, Some(out)) => Ok((out.clone(), RunStart::New)),
            (Some(None), Some(out)) => Ok((out.clone(), RunStart::Resume)),
            (Some(Some(given)), None) => match checkpoint::locate(given) {
                (run, Some(from)) if run != *given => Ok((run, RunStart::ResumeFrom(from))),
                (run, _) => Ok((run, RunStart::Resume)),
            },
            (Some(Some(_)), Some(_)) => {
                Err(CliError::input("--out: omit it with --resume RUN; a run resumes in its own folder"))
            }
            (_, None) => Err(CliError::input("--resume: name the run, such as --resume checkpoints/first")),
        }
    }

    fn print(&self, out: &Path, outcome: &RunOutcome) -> Result<(), CliError> {
        let r = &outcome.record;
        let next = if outcome.reason.is_complete() {
            format!("volseggs eval {}", shell::path(out))
        } else if r.steps == 0 {
            // there is no checkpoint to resume from
            let words = [&r.dataset, &RunPaths(out).config(), &out.to_owned()].map(|path| shell::path(path));
            format!("volseggs train --data {} --config {} --out {}", words[0], words[1], words[2])
        } else {
            format!("volseggs train --resume {}", shell::path(out))
        };
        errln!(
            "{} after {} steps, {:.1} min{}, peak memory {:.2} GB{}; next: {next}",
            r.status,
            r.steps,
            r.training_seconds / 60.0,
            if r.gaussians > 0 { format!(", {} Gaussians", r.gaussians) } else { String::new() },
            r.peak_memory_bytes as f64 / 1e9,
            outcome.test_psnr.map(|p| format!(", test PSNR {p:.2} dB on a few views")).unwrap_or_default(),
        );
        if self.common.json {
            print_json(&Versioned::new(r))?;
        }
        match outcome.reason {
            StopReason::Requested => Err(CliError::failure("interrupted")),
            StopReason::AllSteps | StopReason::TimeLimit | StopReason::StepLimit => Ok(()),
        }
    }
}
