//! `volseggs segment`: two-level segmentation of a run's scene.

mod change;
mod coarse;
mod fine;
mod history;
mod list;
mod masks;
mod pick;
mod split;

use super::CliError;
use super::run_folder::RunFolder;
use crate::export::images::encode_png;
use crate::files::write_atomic;
use crate::memory::Budget;
use crate::points::kmeans;
use crate::segment::fine::AffinityField;
use crate::segment::fine::file::{self, AffinitySpec};
use burn::tensor::Device;
use clap::{Args, Subcommand};
use image::RgbImage;
use std::path::Path;

/// Find segments: by colour, and within a colour by masks of rendered views.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs segment coarse RUN --time 0.5              # segments by colour\n  volseggs segment masks RUN                          # 2D masks of each from 30 views\n  volseggs segment fine RUN                           # train the affinity field on them\n  volseggs segment split RUN red --scale 0.2          # parts of a segment, from small to large\n  volseggs segment pick RUN --view 12 --pixel 210,180 --name part   # what is like a click\n  volseggs segment group RUN pair red.1 red.2         # several as one\n  volseggs segment undo RUN                           # take the last change back\n  volseggs segment list RUN\n\nAll of it lies in RUN/segments/."
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
    Split(split::SplitArgs),
    Pick(pick::PickArgs),
    Group(change::GroupArgs),
    Remove(change::RemoveArgs),
    Undo(history::UndoArgs),
    Redo(history::RedoArgs),
    List(list::ListArgs),
}

impl SegmentArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        match self.command {
            SegmentCommand::Coarse(args) => args.run(),
            SegmentCommand::Masks(args) => args.run(),
            SegmentCommand::Fine(args) => args.run(),
            SegmentCommand::Split(args) => args.run(),
            SegmentCommand::Pick(args) => args.run(),
            SegmentCommand::Group(args) => args.run(),
            SegmentCommand::Remove(args) => args.run(),
            SegmentCommand::Undo(args) => args.run(),
            SegmentCommand::Redo(args) => args.run(),
            SegmentCommand::List(args) => args.run(),
        }
    }
}

/// Refuses more clusters than `points`, or more than memory has room for; `of` says what has the points.
fn check_clusters(clusters: usize, points: usize, of: &str, dimensions: usize) -> Result<(), CliError> {
    if clusters > points {
        return Err(CliError::input(format!("--clusters {clusters}: {of} only {points} Gaussians")));
    }
    let needed = kmeans::memory(points, dimensions, clusters);
    Budget::now().check(format!("--clusters {clusters}"), needed).map_err(CliError::input)
}

/// The run's affinity field.
fn affinity(run: &RunFolder, device: &Device) -> Result<(AffinityField, AffinitySpec), CliError> {
    let path = run.path.join(file::FILE);
    if !path.exists() {
        return Err(CliError::input(format!("{}: no affinity field; run `volseggs segment fine`", path.display())));
    }
    let (field, spec) = file::load(&path, device).map_err(CliError::input)?;
    if spec.scene != run.scene.fingerprint() {
        return Err(CliError::input(format!(
            "{}: trained on another state of this scene; run `volseggs segment fine` again",
            path.display()
        )));
    }
    Ok((field, spec))
}

/// Writes a picture into the run folder.
fn write_picture(path: &Path, picture: &RgbImage) -> Result<(), CliError> {
    let fail = |e: &dyn std::fmt::Display| CliError::failure(format!("{}: {e}", path.display()));
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|e| fail(&e))?;
    }
    write_atomic(path, &encode_png(picture).map_err(|e| fail(&e))?).map_err(|e| fail(&e))
}
