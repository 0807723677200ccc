//! `volseggs segment fine`

use super::super::settings::{SegmentSettings, set_if_given};
use super::super::values::{cosine_f32, count, not_negative, positive};
use super::super::{CliError, CommonArgs, print_json, stop_flag};
use crate::config::types::segment::MaskScale;
use crate::files::LockDuration;
use crate::log::progress;
use crate::run::affinity::{self, AffinityProgress, TrainedAffinity};
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
    /// Number of steps (`segment.affinity.steps`) [default: 5000].
    #[arg(long, value_parser = count)]
    steps: Option<usize>,
    /// Pixels per step, of the up to 16384 kept of a view; with a margin, time grows with the square of this number
    /// (`segment.affinity.pixels`) [default: 2048].
    #[arg(long, value_parser = count)]
    pixels: Option<usize>,
    /// Learning rate (`segment.affinity.rate`) [default: 0.001].
    #[arg(long, value_parser = positive)]
    rate: Option<f64>,
    /// Cosine above which pixels of different masks repel; -1 is the paper's loss, which has no margin. With a margin,
    /// more parts can be distinguished (`segment.affinity.margin`) [default: 0.5].
    #[arg(long, value_name = "COSINE", value_parser = cosine_f32)]
    margin: Option<f32>,
    /// Scale at which a step queries the field: one drawn for all Gaussians, or that of each Gaussian's own mask, as in
    /// the paper (`segment.affinity.mask_scale`) [default: drawn].
    #[arg(long, value_name = "WHICH", value_enum)]
    mask_scale: Option<MaskScale>,
    /// Weight of the hierarchy loss: what belongs together at one scale stays together at larger ones
    /// (`segment.affinity.hierarchy`) [default: 0].
    #[arg(long, value_name = "W", value_parser = not_negative)]
    hierarchy: Option<f64>,
    /// Random seed.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    settings: SegmentSettings,
    #[command(flatten)]
    common: CommonArgs,
}

impl FineArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let run = self.settings.apply_to(self.common.open_to_write(&self.run, LockDuration::Long)?)?;
        let stop = stop_flag("stopping after this step; nothing is written")?;
        let mut options = run.config.segment.affinity.clone();
        set_if_given(&mut options.steps, self.steps);
        set_if_given(&mut options.pixels, self.pixels);
        set_if_given(&mut options.rate, self.rate);
        set_if_given(&mut options.margin, self.margin);
        set_if_given(&mut options.mask_scale, self.mask_scale);
        set_if_given(&mut options.hierarchy, self.hierarchy);
        let steps = options.steps;
        let mut bar = progress::bar(0, "views");
        let trained = affinity::fit(&run, &options, self.seed, |stage| {
            match stage {
                AffinityProgress::Read { done, all } => {
                    bar.set_length(all as u64);
                    bar.set_position(done as u64);
                }
                AffinityProgress::Begins { views, masks, seconds } => {
                    bar.finish_and_clear();
                    errln!("{views} views of segments, {masks} masks, {seconds:.1} s");
                    bar = progress::bar(steps, "steps");
                }
                AffinityProgress::Step { done, loss } => {
                    bar.set_position(done as u64);
                    bar.set_message(format!("loss {loss:.4}"));
                }
            }
            !stop.load(Ordering::Relaxed)
        })?;
        bar.finish_and_clear();
        let Some(TrainedAffinity { loss, seconds }) = trained else {
            return Err(CliError::failure("interrupted; any existing affinity field is unchanged"));
        };
        let path = run.paths().affinity();
        if self.common.json {
            return print_json(&serde_json::json!({ "file": path, "loss": loss, "seconds": seconds, "steps": steps }));
        }
        outln!("{steps} steps in {seconds:.1} s, loss {loss:.4}");
        errln!("next: volseggs segment split {} SEGMENT --scale 0.3", shell::path(&run.path));
        Ok(())
    }
}
