//! `volseggs segment`: two-level segmentation of a run's scene.

mod coarse;
mod fine;
mod list;
mod masks;

use super::CliError;
use crate::export::images::encode_png;
use crate::files::write_atomic;
use clap::{Args, Subcommand};
use image::RgbImage;
use std::path::Path;

/// Find segments: by colour, and within a colour by masks of rendered views.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs segment coarse RUN --time 0.5              # segments by colour\n  volseggs segment masks RUN                          # 2D masks of each from 30 views\n  volseggs segment fine RUN                           # train the affinity field on them\n  volseggs segment split RUN red --scale 0.2          # parts of a segment, from small to large\n  volseggs segment list RUN\n\nAll of it lies in RUN/segments/."
)]
pub struct SegmentArgs {
    #[command(subcommand)]
    command: SegmentCommand,
}

#[derive(Debug, Subcommand)]
enum SegmentCommand {
    Coarse(coarse::CoarseArgs),
    Masks(masks::MasksArgs),
    Fine(fine::FineArgs),
    Split(fine::SplitArgs),
    List(list::ListArgs),
}

impl SegmentArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        match self.command {
            SegmentCommand::Coarse(args) => args.run(),
            SegmentCommand::Masks(args) => args.run(),
            SegmentCommand::Fine(args) => args.run(),
            SegmentCommand::Split(args) => args.run(),
            SegmentCommand::List(args) => args.run(),
        }
    }
}

/// A time in [0, 1].
fn check_time(time: f64) -> Result<(), CliError> {
    if (0.0..=1.0).contains(&time) { Ok(()) } else { Err(CliError::input(format!("--time {time}: between 0 and 1"))) }
}

/// Writes a picture into the run folder.
fn write_picture(path: &Path, picture: &RgbImage) -> Result<(), CliError> {
    let fail = |e: &dyn std::fmt::Display| CliError::failure(format!("{}: {e}", path.display()));
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|e| fail(&e))?;
    }
    write_atomic(path, &encode_png(picture).map_err(|e| fail(&e))?).map_err(|e| fail(&e))
}
