//! `volseggs eval`

use super::error::or_elsewhere;
use super::eval_segments::SegmentFlags;
use super::values::count;
use super::{CliError, CommonArgs, command_line, print_json};
use crate::data::SplitName;
use crate::eval::diagnosis;
use crate::eval::results::KIND;
use crate::eval::run::Summary;
use crate::eval::speed::RenderSpeed;
use crate::files::{FolderKind, LockDuration};
use crate::log::progress;
use crate::memory::MIB;
use crate::metrics::lpips::LpipsNet;
use crate::metrics::metric::{Networks, display};
use crate::metrics::values::MetricValues;
use crate::run::measure::{MeasuredOn, measure};
use crate::run::{AnyRun, OpenRun, TrainedModel};
use crate::versioned::Versioned;
use clap::Args;
use std::path::{Path, PathBuf};

/// Relative difference from which two measurements of the same speed are both told.
const SAME: f64 = 0.02;

/// Evaluate a run on a split: PSNR, SSIM, LPIPS, frames per second, size.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs eval checkpoints/first\n  volseggs eval checkpoints/first --split train --views 50 --json\n  volseggs eval checkpoints/first --lpips-weights lpips_alex.safetensors --lpips-weights lpips_vgg.safetensors\n  volseggs eval checkpoints/first --segments                    # segmentation and tracking against known segments\n  volseggs eval /shared/run --out my-eval                      # a run that cannot be written to\n  volseggs eval checkpoints/first --segments --masks labels --methods fine,coarse+fine\n  volseggs eval checkpoints/first --segments --score tubes=tube-a+tube-b    # two known segments as one\n\nWrites RUN/eval/SPLIT/, or with --out DIR that folder: views.csv, mean.json, contact-sheet.png, psnr-over-time.svg, pictures/; with --segments RUN/eval/segments/:\ntable.md, segments.csv, tracking.csv, volumes.csv, segments.json, segments.png, iou-3d-METHOD.svg, iou-METHOD.svg.\nResults on a dataset other than the run's own (--data) go to separate folders, RUN/eval/SPLIT-NAME/."
)]
pub struct EvalArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Split: train, val or test.
    #[arg(long, default_value = "test", conflicts_with = "segments")]
    split: SplitName,
    /// Dataset folder, if it has moved since training or is another one.
    #[arg(long, value_name = "DATASET")]
    data: Option<PathBuf>,
    /// Maximum number of views, evenly spaced; all if not given.
    #[arg(long, value_name = "N", value_parser = count, conflicts_with = "segments")]
    views: Option<usize>,
    /// LPIPS weights (safetensors); AlexNet or VGG-16 is recognised. May be given twice. `volseggs lpips --help` shows
    /// how to make them from the published files.
    #[arg(long, value_name = "FILE")]
    lpips_weights: Vec<PathBuf>,
    /// Write the results into this folder, and nothing into RUN: for runs of others. An older evaluation in it is
    /// replaced as a whole, anything else is refused.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    common: CommonArgs,
    // a heading stays in force for what follows
    #[command(flatten)]
    segments: SegmentFlags,
}

impl EvalArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (name, device) = self.common.device()?;
        let run = match &self.out {
            Some(_) => AnyRun::open_any(&self.run, &device)?,
            None => {
                AnyRun::open_locked(&self.run, &device, &command_line(), LockDuration::Long).map_err(or_elsewhere)?
            }
        };
        let networks = Networks::load(&self.lpips_weights, &device).map_err(CliError::input)?;
        if let (false, Some(flag)) = (self.segments.segments, self.segments.settings.given()) {
            return Err(CliError::input(format!("{flag}: only for --segments")));
        }
        if self.segments.segments {
            let mut given = self.lpips_weights.iter().zip(networks.lpips());
            if let Some((path, _)) = given.find(|(_, network)| network.net() != LpipsNet::Alex) {
                return Err(CliError::input(format!(
                    "--lpips-weights {}: weights of VGG-16, but --segments measures LPIPS with AlexNet only; omit them",
                    path.display()
                )));
            }
            let out = self.out.as_deref();
            let run = self.segments.settings.apply_to(run.gaussians()?)?;
            return self.segments.run(&run, self.data.as_deref(), out, networks.lpips(), self.common.json);
        }
        let split = run.measured(self.split, self.data.as_deref(), self.views)?;
        if !run.config.data.only_times.is_empty() {
            let times: Vec<String> = split.times().iter().map(|t| format!("{t:.3}")).collect();
            errln!(
                "note: data.only_times: measured on the views nearest to the training times, at {}",
                times.join(", ")
            );
        }
        let on = MeasuredOn::open(&run, self.data.as_deref(), self.split)?;
        let folder = results(&run, &on, self.split.as_str(), self.out.as_deref(), &KIND)?;
        let bar = progress::bar(split.frames.len(), "views");
        let evaluation = measure(&run, &split, &networks, &on, &folder, |done, metrics| {
            bar.set_position(done as u64);
            bar.set_message(metrics.headline_text());
        })?;
        bar.finish_and_clear();
        let s = &evaluation.summary;
        if self.common.json {
            return print_json(&Versioned::new(s));
        }
        outln!("views          {} ({}x{}, {} split)", s.views, s.width, s.height, s.split);
        metric_lines(&s.metrics).iter().for_each(|line| outln!("{line}"));
        print_diagnosis(s);
        let drawn = if s.gaussians > 0 { "deformation and splatting" } else { "everything that drawing takes" };
        print_speed(&s.speed, name.is_cpu(), drawn);
        outln!("training       {:.1} min", s.training_seconds / 60.0);
        let bytes = s.model_bytes as f64;
        let held =
            if s.gaussians > 0 { format!("{} Gaussians", s.gaussians) } else { format!("{} parameters", s.parameters) };
        let bits = if run.is_packed() { "packed in 8 and 16 bits" } else { "in f32" };
        outln!("model          {:.2} MiB ({:.2} MB), scene.safetensors {bits}, {held}", bytes / MIB, bytes / 1e6);
        for note in &s.notes {
            outln!("note: {note}");
        }
        errln!("results by view, and pictures: {}", folder.display());
        Ok(())
    }
}

/// The values as lines, each with the metrics of one abbreviation.
fn metric_lines(values: &MetricValues) -> Vec<String> {
    let shown: Vec<_> = values.in_order().into_iter().map(|(name, value)| (display(name), value)).collect();
    let lines = shown.chunk_by(|(a, _), (b, _)| a.short == b.short).map(|alike| {
        let cells = alike.iter().map(|(shown, value)| {
            let value = value.map_or_else(|| "-".to_owned(), |value| shown.with_unit(value));
            if shown.note.is_empty() { value } else { format!("{value} ({})", shown.note) }
        });
        format!("{:<14} {}", alike[0].0.short, cells.collect::<Vec<_>>().join("   "))
    });
    lines.collect()
}

/// Prints the frames per second. On a CPU, images are on the host anyway: both figures measure the same, and their mean is
/// printed, with the two if they differ.
fn print_speed(speed: &RenderSpeed, on_cpu: bool, drawn: &str) {
    let (frames, with_copy) = (speed.fps_frames, speed.fps_with_copy);
    let of = |frames: usize, spread: &str| format!("({frames} frames{spread}): {drawn}, repeated for each frame");
    let fps = speed.fps;
    if on_cpu {
        let mean = 2.0 / (1.0 / fps + 1.0 / with_copy);
        let (low, high) = (fps.min(with_copy), fps.max(with_copy));
        let spread =
            if high - low > SAME * mean { format!("; {low:.1} and {high:.1} in two rounds") } else { String::new() };
        outln!("frames/second  {mean:.1} {}", of(2 * frames, &spread));
    } else {
        outln!("frames/second  {fps:.1} {}", of(frames, ""));
        outln!("               {with_copy:.1} with the copy of each image to the host");
    }
}

/// Prints what bounds the quality, as aligned columns.
fn print_diagnosis(summary: &Summary) {
    let rows: Vec<[String; 6]> = std::iter::once(diagnosis::head()).chain(diagnosis::rows(summary)).collect();
    let width = |c: usize| rows.iter().map(|row| row[c].chars().count()).max().unwrap_or(0);
    let widths: [usize; 6] = std::array::from_fn(width);
    for row in &rows {
        let figures: String = (1..6).map(|c| format!("   {:>1$}", row[c], widths[c])).collect();
        outln!("  {}", format!("{:<1$}{figures}", row[0], widths[0]).trim_end());
    }
}

/// The folder of results called `what`, or the one given with --out; prints any notes about the evaluation data.
pub(super) fn results<S: TrainedModel>(
    run: &OpenRun<S>,
    on: &MeasuredOn,
    what: &str,
    out: Option<&Path>,
    kind: &FolderKind,
) -> Result<PathBuf, CliError> {
    if let Some(note) = &on.note {
        errln!("note: {note}");
    }
    let folder = match out {
        Some(out) => {
            let inputs = [run.path.as_path(), &on.data.dataset];
            kind.check(out, &inputs)?;
            out.to_owned()
        }
        None => on.folder(run, what, kind)?,
    };
    if !on.is_own(run) {
        let why = if on.other_views { "has other views to measure than" } else { "is not" };
        errln!(
            "note: {} {why} the dataset that {} was trained on; results go to {}",
            on.data.dataset.display(),
            run.path.display(),
            folder.display()
        );
    }
    Ok(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metrics_of_one_abbreviation_share_a_line() {
        let values = [("psnr", 27.304), ("ssim", 0.9), ("ssim_gray", 0.95), ("lpips_vgg", 0.1), ("mine", 0.25)];
        assert_eq!(
            metric_lines(&values.into_iter().collect()),
            [
                "PSNR           27.30 dB",
                "SSIM           0.9000 (RGB, Gaussian window)   0.9500 (grey, 7x7)",
                "LPIPS          - (AlexNet)   0.1000 (VGG-16)",
                "mine           0.2500",
            ]
        );
    }
}
