//! `volseggs segment`: two-level segmentation of a run's scene.

mod change;
mod coarse;
mod fine;
mod list;
mod masks;
mod pick;
mod split;

use super::CliError;
use crate::run::segments::HistoryDirection;
use clap::{Args, Subcommand};

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
    /// Undo the last changes of the segments.
    #[command(
        after_help = "Examples:\n  volseggs segment undo RUN\n  volseggs segment undo RUN --count 2\n\nThe last 50 changes are remembered. Masks, the affinity field and pictures are not affected."
    )]
    Undo(change::StepArgs),
    /// Redo the changes of the segments that were undone last.
    #[command(after_help = "Example:\n  volseggs segment redo RUN")]
    Redo(change::StepArgs),
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
            SegmentCommand::Undo(args) => args.run(HistoryDirection::Undo, "undone"),
            SegmentCommand::Redo(args) => args.run(HistoryDirection::Redo, "redone"),
            SegmentCommand::List(args) => args.run(),
        }
    }
}
