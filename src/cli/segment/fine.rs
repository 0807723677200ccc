//! `volseggs segment fine`

use super::super::values::{cosine_f32, count, not_negative, positive};
use super::super::{CliError, Common, command_line, print_json, stop_flag};
use crate::files::Work;
use crate::log::progress;
use crate::run::OpenRun;
use crate::run::affinity::{self, Stage, Trained};
use crate::segment::fine::train::{FineOptions, MARGIN, MaskScale, repulsion};
use crate::shell;
use clap::Args;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

/// Train the affinity field on the masks.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs segment fine RUN\n  volseggs segment fine RUN --margin -1 --pixels 8192 --mask-scale own   # as in the paper\n\nReads RUN/segments/masks.jsonl, writes RUN/segments/affinity.safetensors."
)]
pub struct FineArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Number of steps.
    #[arg(long, default_value_t = FineOptions::default().steps, value_parser = count)]
    steps: usize,
    /// Pixels per step, of the up to 16384 kept of a view; with a margin, time grows with the square of this number.
    #[arg(long, default_value_t = 2048, value_parser = count)]
    pixels: usize,
    /// Learning rate.
    #[arg(long, default_value_t = 1e-3, value_parser = positive)]
    rate: f64,
    /// Cosine above which pixels of different masks repel; -1 is the paper's loss, which has no margin. With a margin,
    /// more parts can be distinguished.
    #[arg(long, value_name = "COSINE", default_value_t = MARGIN, value_parser = cosine_f32)]
    margin: f32,
    /// Scale at which a step queries the field: one drawn for all Gaussians, or that of each Gaussian's own mask, as in
    /// the paper [drawn, own].
    #[arg(long, value_name = "WHICH", default_value = "drawn")]
    mask_scale: MaskScale,
    /// Weight of the hierarchy loss: what belongs together at one scale stays together at larger ones.
    #[arg(long, value_name = "W", default_value_t = 0.0, value_parser = not_negative)]
    hierarchy: f64,
    /// Random seed.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    common: Common,
}

impl FineArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let run = OpenRun::open_to_write(&self.run, &device, &command_line(), Work::Long)?;
        let stop = stop_flag("stopping after this step; nothing is written")?;
        let options = FineOptions {
            steps: self.steps,
            pixels: self.pixels,
            rate: self.rate,
            repulsion: repulsion(self.margin),
            mask_scale: self.mask_scale,
            hierarchy: self.hierarchy,
            seed: self.seed,
        };
        let mut bar = progress::bar(0, "views");
        let trained = affinity::fit(&run, &options, &device, |stage| {
            match stage {
                Stage::Read { done, all } => {
                    bar.set_length(all as u64);
                    bar.set_position(done as u64);
                }
                Stage::Begins { views, masks, seconds } => {
                    bar.finish_and_clear();
                    errln!("{views} views of segments, {masks} masks, {seconds:.1} s");
                    bar = progress::bar(self.steps, "steps");
                }
                Stage::Step { done, loss } => {
                    bar.set_position(done as u64);
                    bar.set_message(format!("loss {loss:.4}"));
                }
            }
            !stop.load(Ordering::Relaxed)
        })?;
        bar.finish_and_clear();
        let Some(Trained { loss, seconds }) = trained else {
            return Err(CliError::failure("interrupted; any existing affinity field is unchanged"));
        };
        let path = run.paths().affinity();
        if self.common.json {
            return print_json(
                &serde_json::json!({ "file": path, "loss": loss, "seconds": seconds, "steps": self.steps }),
            );
        }
        outln!("{} steps in {seconds:.1} s, loss {loss:.4}", self.steps);
        errln!("next: volseggs segment split {} SEGMENT --scale 0.3", shell::path(&run.path));
        Ok(())
    }
}
