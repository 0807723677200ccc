//! `volseggs eval`

use super::eval_segments::SegmentFlags;
use super::run_folder::RunFolder;
use super::{CliError, Common, print_json};
use crate::data::SplitName;
use crate::eval::results::write_results;
use crate::eval::run::{Costs, evaluate};
use crate::files::Work;
use crate::log::progress;
use crate::metrics::lpips::Lpips;
use clap::Args;
use std::path::PathBuf;

/// Measure a run on a split: PSNR, SSIM, LPIPS, frames per second, size.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs eval checkpoints/first\n  volseggs eval checkpoints/first --split train --views 50 --json\n  volseggs eval checkpoints/first --lpips-weights lpips_alex.safetensors --lpips-weights lpips_vgg.safetensors\n  volseggs eval checkpoints/first --segments                    # segmentation and tracking against known segments\n  volseggs eval checkpoints/first --segments --masks labels --methods fine,coarse+fine\n\nWrites RUN/eval/SPLIT/: views.csv, mean.json, contact-sheet.png, psnr-over-time.svg; with --segments RUN/eval/segments/:\ntable.md, segments.csv, tracking.csv, segments.json, segments.png, iou-METHOD.svg."
)]
pub struct EvalArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Split: train, val or test.
    #[arg(long, default_value = "test")]
    split: SplitName,
    /// Dataset folder, if it is not where it was in training.
    #[arg(long, value_name = "DATASET")]
    data: Option<PathBuf>,
    /// At most this many views, evenly spaced; all if not given.
    #[arg(long, value_name = "N")]
    views: Option<usize>,
    /// LPIPS weights (safetensors: net.conv*.weight, lin0..4); AlexNet or VGG-16 is recognised. May be given twice.
    #[arg(long, value_name = "FILE")]
    lpips_weights: Vec<PathBuf>,
    #[command(flatten)]
    segments: SegmentFlags,
    #[command(flatten)]
    common: Common,
}

impl EvalArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let run = RunFolder::open_to_write(&self.run, &device, Work::Long)?;
        let networks = self
            .lpips_weights
            .iter()
            .map(|path| Lpips::load(path, &device).map_err(CliError::input))
            .collect::<Result<Vec<_>, _>>()?;
        if self.segments.segments {
            return self.segments.run(&run, self.data.as_deref(), &networks, self.common.json);
        }
        let split = run.split(self.split, self.data.as_deref(), self.views)?;
        let costs = Costs {
            training_seconds: run.record.training_seconds,
            model_bytes: std::fs::metadata(&run.scene_path).map_err(CliError::failure)?.len(),
        };
        let bar = progress::bar(split.frames.len(), "views");
        let evaluation = evaluate(&run.scene, &split, &networks, &costs, |done, psnr| {
            bar.set_position(done as u64);
            bar.set_message(format!("{psnr:.2} dB"));
        })
        .map_err(CliError::failure)?;
        bar.finish_and_clear();

        let folder = run.path.join("eval").join(self.split.as_str());
        write_results(&folder, &evaluation).map_err(CliError::failure)?;
        let s = &evaluation.summary;
        if self.common.json {
            return print_json(s);
        }
        let lpips = |v: Option<f64>| v.map_or("-".to_owned(), |v| format!("{v:.4}"));
        outln!("views          {} ({}x{}, {} split)", s.views, s.width, s.height, s.split);
        outln!("PSNR           {:.2} dB", s.psnr);
        outln!("SSIM           {:.4} (RGB, Gaussian window)   {:.4} (grey, 7x7)", s.ssim, s.ssim_gray);
        outln!("LPIPS          {} (AlexNet)   {} (VGG-16)", lpips(s.lpips_alex), lpips(s.lpips_vgg));
        if self.lpips_weights.is_empty() {
            errln!("note: LPIPS needs --lpips-weights; `volseggs lpips --help` says where they come from");
        }
        for (name, value) in &s.extra {
            outln!("{name:<14} {value:.4}");
        }
        outln!("frames/second  {:.1}", s.fps);
        outln!("training       {:.1} min", s.training_seconds / 60.0);
        outln!("model          {:.2} MB, {} Gaussians", s.model_bytes as f64 / 1e6, s.gaussians);
        for note in &s.notes {
            outln!("note: {note}");
        }
        errln!("per view, pictures: {}", folder.display());
        Ok(())
    }
}
