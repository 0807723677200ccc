//! `volseggs export`

use super::run_folder::RunFolder;
use super::{CliError, Common, print_json};
use crate::export::ply::PlyGaussians;
use crate::export::scene::at_time;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Write a run's Gaussians as standard files.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs export checkpoints/first --time 0.5 --out scene.ply\n  volseggs export checkpoints/first --frames 30 --out plys/\n\nThe PLY follows 3DGS and opens in its viewers (SuperSplat, antimatter15, gsplat)."
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
    /// File, or folder with --frames.
    #[arg(long, value_name = "OUT")]
    out: PathBuf,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Binary PLY in the convention of 3DGS.
    Ply,
}

impl ExportArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let Format::Ply = self.format;
        if !(0.0..=1.0).contains(&self.time) {
            return Err(CliError::input(format!("--time {}: between 0 and 1", self.time)));
        }
        let (_, device) = self.common.device()?;
        let run = RunFolder::open(&self.run, &device)?;
        let mut files = Vec::new();
        match self.frames {
            None => files.push((self.out.clone(), self.time)),
            Some(0) => return Err(CliError::input("--frames 0: at least 1")),
            Some(n) => {
                std::fs::create_dir_all(&self.out)
                    .map_err(|e| CliError::failure(format!("{}: {e}", self.out.display())))?;
                let time = |i: usize| i as f64 / (n - 1).max(1) as f64;
                files.extend((0..n).map(|i| (self.out.join(format!("{i:04}.ply")), time(i))));
            }
        }
        for (path, time) in &files {
            let ply: PlyGaussians = at_time(&run.scene, *time as f32);
            ply.write(path).map_err(CliError::failure)?;
        }
        let paths: Vec<&PathBuf> = files.iter().map(|(p, _)| p).collect();
        eprintln!("{} file(s), {} Gaussians each: {}", files.len(), run.scene.gaussians.count(), self.out.display());
        if self.common.json {
            print_json(&serde_json::json!({ "files": paths, "gaussians": run.scene.gaussians.count() }))?;
        }
        Ok(())
    }
}
