//! `volseggs export`

use super::run_folder::RunFolder;
use super::shown::Shown;
use super::{CliError, Common, print_json};
use crate::export::scene::to_ply;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Write a run's Gaussians as standard files.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs export checkpoints/first --time 0.5 --out scene.ply\n  volseggs export checkpoints/first --frames 30 --out plys/\n  volseggs export checkpoints/first --segment red --no-edits --out red.ply\n\nThe PLY follows 3DGS and opens in its viewers (SuperSplat, antimatter15, gsplat). It holds the edits of the run; Gaussians that they hide are left out."
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
    shown: Shown,
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
        if !(0.0..=1.0).contains(&self.time) {
            return Err(CliError::input(format!("--time {}: between 0 and 1", self.time)));
        }
        let (_, device) = self.common.device()?;
        let run = RunFolder::open(&self.run, &device)?;
        match self.format {
            Format::Ply => self.write_ply(&run),
        }
    }

    /// What to write, and at which times: OUT, or `0000.EXTENSION` and so on in the folder OUT, which is made.
    fn files(&self, extension: &str) -> Result<Vec<(PathBuf, f64)>, CliError> {
        let mut files = Vec::new();
        match self.frames {
            None => files.push((self.out.clone(), self.time)),
            Some(0) => return Err(CliError::input("--frames 0: at least 1")),
            Some(n) => {
                std::fs::create_dir_all(&self.out)
                    .map_err(|e| CliError::failure(format!("{}: {e}", self.out.display())))?;
                let time = |i: usize| i as f64 / (n - 1).max(1) as f64;
                files.extend((0..n).map(|i| (self.out.join(format!("{i:04}.{extension}")), time(i))));
            }
        }
        Ok(files)
    }

    fn write_ply(&self, run: &RunFolder) -> Result<(), CliError> {
        let shown = self.shown.select(run)?;
        // what is hidden is so at every time
        let count = shown.visible(&run.scene, 0.0)?.len();
        if count == 0 {
            return Err(CliError::input(
                "nothing to write: no Gaussian is left; see `volseggs edit list`, or pass --no-edits",
            ));
        }
        let files = self.files("ply")?;
        for (path, time) in &files {
            let at = shown.visible(&run.scene, *time as f32)?;
            to_ply(at).write(path).map_err(CliError::failure)?;
        }
        let paths: Vec<&PathBuf> = files.iter().map(|(p, _)| p).collect();
        eprintln!("{} file(s), {} Gaussians each: {}", files.len(), count, self.out.display());
        if self.common.json {
            print_json(&serde_json::json!({ "files": paths, "gaussians": count }))?;
        }
        Ok(())
    }
}
