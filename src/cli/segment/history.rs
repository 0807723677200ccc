//! `volseggs segment undo` and `segment redo`, and how every command here changes segments.

use super::super::run_folder::RunFolder;
use super::super::values::count;
use super::super::{CliError, Common, print_json};
use crate::files::Work;
use crate::segment::history;
use crate::segment::segmentation::{Segment, Segmentation};
use clap::Args;
use std::path::PathBuf;

/// The segments of a run with what was done to them.
pub(super) struct History {
    path: PathBuf,
    found: history::History,
}

impl History {
    /// Reads them; none if there is no file yet.
    pub(super) fn open(run: &RunFolder) -> Result<Self, CliError> {
        let path = run.segments_path();
        if !path.exists() {
            return Ok(Self { path, found: history::History::new(run.segments()?) });
        }
        let found = history::History::load(&path).map_err(CliError::input)?;
        run.check_segments(found.now())?;
        Ok(Self { path, found })
    }

    /// The same for a command that puts others in their place: a file that cannot be used is no reason to stop.
    pub(super) fn replacing(run: &RunFolder) -> Self {
        Self::open(run).unwrap_or_else(|error| {
            errln!("the segments of before cannot be brought back by undo: {error}");
            let none = Segmentation::new(run.scene.gaussians.count(), run.scene.fingerprint());
            Self { path: run.segments_path(), found: history::History::new(none) }
        })
    }

    /// The segments of now.
    pub(super) fn now(&self) -> &Segmentation {
        self.found.now()
    }

    /// Puts segments in the place of those of now; `change` says what was done.
    pub(super) fn change(&mut self, change: String, segments: Vec<Segment>) {
        self.found.change(change, segments);
    }

    /// Writes the file.
    pub(super) fn save(&self) -> Result<(), CliError> {
        self.found.save(&self.path).map_err(CliError::failure)
    }

    /// Changes that can be undone, the next one first.
    pub(super) fn undoable(&self) -> Vec<&str> {
        self.found.undoable()
    }

    /// Changes that can be redone, the next one first.
    pub(super) fn redoable(&self) -> Vec<&str> {
        self.found.redoable()
    }
}

#[derive(Clone, Copy)]
enum Towards {
    Undo,
    Redo,
}

#[derive(Debug, Args)]
struct Step {
    /// Folder of the run.
    run: PathBuf,
    /// How many.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = count)]
    count: usize,
    #[command(flatten)]
    common: Common,
}

/// Take back the last changes of the segments.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs segment undo RUN\n  volseggs segment undo RUN --count 2\n\nThe last 50 changes are remembered. Masks, the affinity field and pictures stay as they are."
)]
pub struct UndoArgs {
    #[command(flatten)]
    step: Step,
}

/// Bring back changes of the segments that were taken back last.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  volseggs segment redo RUN")]
pub struct RedoArgs {
    #[command(flatten)]
    step: Step,
}

impl UndoArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        self.step.run(Towards::Undo)
    }
}

impl RedoArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        self.step.run(Towards::Redo)
    }
}

impl Step {
    /// Takes all of the steps or none.
    fn run(self, towards: Towards) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let run = RunFolder::open_to_write(&self.run, &device, Work::Short)?;
        let mut history = History::open(&run)?;
        let (there, what, done) = match towards {
            Towards::Undo => (history.undoable().len(), "undo", "undone"),
            Towards::Redo => (history.redoable().len(), "redo", "redone"),
        };
        if there == 0 {
            return Err(CliError::input(format!("nothing to {what} in {}", history.path.display())));
        }
        if self.count > there {
            let count = self.count;
            return Err(CliError::input(format!(
                "--count {count}: between 1 and {there}, as many as there are to {what}"
            )));
        }
        let step = |_| match towards {
            Towards::Undo => history.found.undo(),
            Towards::Redo => history.found.redo(),
        };
        let steps: Vec<String> = (0..self.count).filter_map(step).collect();
        history.save()?;
        let names: Vec<&str> = history.now().segments.iter().map(|s| s.name.as_str()).collect();
        if self.common.json {
            return print_json(&serde_json::json!({
                done: steps, "segments": names, "undo": history.undoable(), "redo": history.redoable(),
            }));
        }
        for step in &steps {
            outln!("{done}: {step}");
        }
        errln!("segments: {}", if names.is_empty() { "none".into() } else { names.join(", ") });
        Ok(())
    }
}
