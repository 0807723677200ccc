//! `volseggs export`: what every format shares; one file for each kind of output.

mod label_grid;
mod labels;
mod ply;
mod truth;

use super::run_folder::RunFolder;
use super::shown::Shown;
use super::{CliError, Common};
use clap::{Args, ValueEnum};
use labels::LabelArgs;
use std::path::{Path, PathBuf};

/// Write a run's Gaussians or the labels of its segments as standard files.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs export checkpoints/first --time 0.5 --out scene.ply\n  volseggs export checkpoints/first --frames 30 --out plys/\n  volseggs export checkpoints/first --segment red --no-edits --out red.ply\n  volseggs export checkpoints/first --format nrrd --time 0.5 --out labels.seg.nrrd\n  volseggs export checkpoints/first --format vti --time 0.5 --segment red.1 --segment red.2 --like volume.vti\n  volseggs export checkpoints/first --format nrrd --time 0.5 --truth labels_050.nrrd\n\nThe PLY follows 3DGS and opens in its viewers (SuperSplat, antimatter15, gsplat). It holds the edits of the run; Gaussians that they hide are left out.\nLabels fall on the voxels of the volume that the dataset was prepared from: label 1 is the first segment named, 0 is none.\nWithout --segment they are the segments that have no parts; a Gaussian takes the last named that holds it.\nA file called .seg.nrrd opens in 3D Slicer as a segmentation."
)]
pub struct ExportArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Format.
    #[arg(long, value_enum, default_value_t = Format::Ply)]
    format: Format,
    /// Time in [0, 1].
    #[arg(long, default_value_t = 0.0, conflicts_with = "frames")]
    time: f64,
    /// Write so many evenly spaced times from 0 to 1, into the folder OUT.
    #[arg(long, value_name = "N")]
    frames: Option<usize>,
    /// File, or folder with --frames; labels go to RUN/labels if not given.
    #[arg(long, value_name = "OUT")]
    out: Option<PathBuf>,
    #[command(flatten)]
    shown: Shown,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    labels: LabelArgs,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Binary PLY in the convention of 3DGS.
    Ply,
    /// Labels of segments on voxels, for 3D Slicer and others.
    Nrrd,
    /// Labels of segments on voxels, for VTK and ParaView.
    Vti,
}

impl ExportArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        if !(0.0..=1.0).contains(&self.time) {
            return Err(CliError::input(format!("--time {}: between 0 and 1", self.time)));
        }
        if self.frames == Some(0) {
            return Err(CliError::input("--frames 0: at least 1"));
        }
        if let (Format::Ply, Some(flag)) = (self.format, self.labels.given()) {
            return Err(CliError::input(format!("{flag}: is for labels; add --format nrrd or --format vti")));
        }
        let (_, device) = self.common.device()?;
        let run = RunFolder::open(&self.run, &device)?;
        match self.format {
            Format::Ply => ply::run(&self, &run),
            Format::Nrrd | Format::Vti => labels::run(&self, &run),
        }
    }

    /// The files to write with their times: `out` itself, or with `--frames` those inside, called by number. Makes the
    /// folder.
    fn files(&self, out: &Path, extension: &str) -> Result<Vec<(PathBuf, f64)>, CliError> {
        let Some(n) = self.frames else { return Ok(vec![(out.to_owned(), self.time)]) };
        std::fs::create_dir_all(out).map_err(|e| CliError::failure(format!("{}: {e}", out.display())))?;
        let time = |i: usize| i as f64 / (n - 1).max(1) as f64;
        Ok((0..n).map(|i| (out.join(format!("{i:04}.{extension}")), time(i))).collect())
    }
}
