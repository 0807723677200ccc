//! `volseggs segment undo` and `segment redo`

use super::super::values::count;
use super::super::{CliError, Common, print_json};
use super::{names, open_to_change};
use crate::run::segments::Towards;
use clap::Args;
use std::path::PathBuf;

#[derive(Debug, Args)]
struct Step {
    /// Folder of the run.
    run: PathBuf,
    /// Number of changes.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = count)]
    count: usize,
    #[command(flatten)]
    common: Common,
}

/// Undo the last changes of the segments.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs segment undo RUN\n  volseggs segment undo RUN --count 2\n\nThe last 50 changes are remembered. Masks, the affinity field and pictures are not affected."
)]
pub struct UndoArgs {
    #[command(flatten)]
    step: Step,
}

/// Redo the changes of the segments that were undone last.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  volseggs segment redo RUN")]
pub struct RedoArgs {
    #[command(flatten)]
    step: Step,
}

impl UndoArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        self.step.run(Towards::Undo, "undone")
    }
}

impl RedoArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        self.step.run(Towards::Redo, "redone")
    }
}

impl Step {
    fn run(self, towards: Towards, done: &str) -> Result<(), CliError> {
        let (_run, mut segments) = open_to_change(&self.run, &self.common)?;
        let steps = segments.step(towards, self.count)?;
        segments.save()?;
        let names = names(&segments);
        if self.common.json {
            return print_json(&serde_json::json!({
                done: steps, "segments": names,
                "undo": segments.steps(Towards::Undo), "redo": segments.steps(Towards::Redo),
            }));
        }
        for step in &steps {
            outln!("{done}: {step}");
        }
        errln!("segments: {}", if names.is_empty() { "none".into() } else { names.join(", ") });
        Ok(())
    }
}
