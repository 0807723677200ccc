//! `volseggs segment fine`

use super::super::run_folder::RunFolder;
use super::super::values::{cosine_f32, count, not_negative, positive};
use super::super::{CliError, Common, print_json, stop_flag};
use crate::files::Work;
use crate::log::progress;
use crate::memory::{Budget, product};
use crate::segment::fine::file::{self, AffinitySpec};
use crate::segment::fine::network::Frame;
use crate::segment::fine::train::{FineError, FineOptions, MaskScale, repulsion, train};
use crate::segment::fine::views::read_views;
use crate::segment::masks::MaskReader;
use crate::segment::segmentation::members_key;
use clap::Args;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Instant;

/// Train the affinity field on the masks.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs segment fine RUN\n  volseggs segment fine RUN --margin -1 --pixels 8192 --mask-scale own   # as the paper\n\nReads RUN/segments/masks.jsonl, writes RUN/segments/affinity.safetensors."
)]
pub struct FineArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Steps.
    #[arg(long, default_value_t = 5000, value_parser = count)]
    steps: usize,
    /// Pixels a step, of the up to 16384 that are kept of a view; with a margin, time grows with their square.
    #[arg(long, default_value_t = 2048, value_parser = count)]
    pixels: usize,
    /// Learning rate.
    #[arg(long, default_value_t = 1e-3, value_parser = positive)]
    rate: f64,
    /// Pixels of different masks repel where their cosine exceeds this; -1 is the paper's loss, without a margin. With
    /// one, more parts find room beside each other.
    #[arg(long, value_name = "COSINE", default_value_t = 0.5, value_parser = cosine_f32, allow_negative_numbers = true)]
    margin: f32,
    /// Scale that a step asks at: drawn for all, or each Gaussian's own mask's, as in the paper [drawn, own].
    #[arg(long, value_name = "WHICH", default_value = "drawn")]
    mask_scale: MaskScale,
    /// Weight of the hierarchy loss: what is together at a scale stays together at larger ones.
    #[arg(long, value_name = "W", default_value_t = 0.0, value_parser = not_negative, allow_negative_numbers = true)]
    hierarchy: f64,
    /// Seed.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    common: Common,
}

impl FineArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let run = RunFolder::open_to_write(&self.run, &device, Work::Long)?;
        let all = run.segments()?;
        let path = run.path.join("segments/masks.jsonl");
        if !path.exists() {
            return Err(CliError::input(format!("{}: no masks yet; run `volseggs segment masks`", path.display())));
        }
        let stop = stop_flag("stopping after this step; nothing is written")?;
        let started = Instant::now();
        let masks = MaskReader::open(&path).map_err(CliError::input)?;
        let header = masks.header().clone();
        if !(0.0..=1.0).contains(&header.time) {
            return Err(CliError::input(format!("{}: header, time: {} is not in [0, 1]", path.display(), header.time)));
        }
        // which pixels the masks of a view cover
        let covered = product(&[header.width as usize, header.height as usize, 2]);
        let what = format!("{}: pictures of {}x{} pixels", path.display(), header.width, header.height);
        Budget::now().check(what, covered).map_err(CliError::input)?;
        let at = run.scene.host_at(header.time as f32);
        let frame = Frame::around(&at.visible_means());
        let again = format!("run `volseggs segment masks {} --replace`", run.path.display());
        let of = |name: &String| {
            let found = all.get(name).map(|s| s.members.clone());
            found.map_err(|e| CliError::input(format!("{}: masks of {name}: {e}; {again}", path.display())))
        };
        let members = header.segments.iter().map(of).collect::<Result<Vec<_>, CliError>>()?;
        let mut keys = header.segments.iter().zip(&header.members).zip(&members);
        if let Some(((name, _), _)) = keys.find(|((_, key), members)| **key != members_key(members)) {
            return Err(CliError::input(format!(
                "{}: segment {name} has other Gaussians now than when its masks were made; {again}",
                path.display()
            )));
        }
        let bar = progress::bar(header.views.len(), "views");
        let (views, spreads) =
            read_views(&masks, &at, &frame, &members, self.seed, &device, |_| bar.inc(1)).map_err(CliError::input)?;
        bar.finish_and_clear();
        errln!("{} views of segments, {} masks, {:.1} s", views.len(), spreads.len(), started.elapsed().as_secs_f64());

        let options = FineOptions {
            steps: self.steps,
            pixels: self.pixels,
            rate: self.rate,
            repulsion: repulsion(self.margin),
            mask_scale: self.mask_scale,
            hierarchy: self.hierarchy,
            seed: self.seed,
        };
        let bar = progress::bar(self.steps, "steps");
        let mut smooth = None;
        let started = Instant::now();
        let field = train(&views, &options, &device, |step, loss| {
            let mean = smooth.map_or(loss, |s: f64| 0.98 * s + 0.02 * loss);
            smooth = Some(mean);
            bar.set_position(step as u64 + 1);
            bar.set_message(format!("loss {mean:.4}"));
            !stop.load(Ordering::Relaxed)
        })
        .map_err(|e| match e {
            FineError::NoMasks => CliError::input(format!("{}: {e}", path.display())),
            FineError::NotFinite { .. } => CliError::input(e),
        })?;
        bar.finish_and_clear();
        if stop.load(Ordering::Relaxed) {
            return Err(CliError::failure("interrupted; the affinity field of before, if any, is as it was"));
        }
        let seconds = started.elapsed().as_secs_f64();
        let spec = AffinitySpec { frame, time: header.time, scene: run.scene.fingerprint(), spreads };
        let path = run.path.join(file::FILE);
        file::save(&path, &field, &spec).map_err(CliError::failure)?;
        let loss = smooth.unwrap_or_default();
        if self.common.json {
            return print_json(
                &serde_json::json!({ "file": path, "loss": loss, "seconds": seconds, "steps": self.steps }),
            );
        }
        outln!("{} steps in {seconds:.1} s, loss {loss:.4}", self.steps);
        errln!("next: volseggs segment split {} SEGMENT --scale 0.3", run.path.display());
        Ok(())
    }
}
