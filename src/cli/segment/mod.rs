//! `volseggs segment`: two-level segmentation of a run's scene.

mod change;
mod coarse;
mod fine;
mod list;
mod masks;
mod pick;
mod split;
mod undo;

use super::{CliError, Common};
use crate::files::Work;
use crate::run::OpenRun;
use crate::run::segments::RunSegments;
use clap::{Args, Subcommand};
use std::path::Path;

/// Find segments: by colour, and within a colour by masks of rendered views.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs segment coarse RUN --time 0.5              # segments by colour\n  volseggs segment masks RUN                          # 2D masks of each from 30 views\n  volseggs segment fine RUN                           # train the affinity field on them\n  volseggs segment split RUN red --scale 0.2          # parts of a segment, from small to large\n  volseggs segment pick RUN --view 12 --pixel 210,180 --name part   # a segment from a click\n  volseggs segment group RUN pair red.1 red.2         # several segments as one\n  volseggs segment undo RUN                           # undo the last change\n  volseggs segment list RUN\n\nEverything is stored in RUN/segments/."
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
    Rename(change::RenameArgs),
    Remove(change::RemoveArgs),
    Undo(undo::UndoArgs),
    Redo(undo::RedoArgs),
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
            SegmentCommand::Rename(args) => args.run(),
            SegmentCommand::Remove(args) => args.run(),
            SegmentCommand::Undo(args) => args.run(),
            SegmentCommand::Redo(args) => args.run(),
            SegmentCommand::List(args) => args.run(),
        }
    }
}

/// Opens a run, which holds its lock, and its segments.
fn open_to_change(run: &Path, common: &Common) -> Result<(OpenRun, RunSegments), CliError> {
    let (run, _) = common.open_to_write(run, Work::Short)?;
    let segments = RunSegments::open(&run)?;
    Ok((run, segments))
}

/// The names of all segments.
fn names(segments: &RunSegments) -> Vec<&str> {
    segments.now().segments.iter().map(|s| s.name.as_str()).collect()
}
