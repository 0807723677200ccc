//! The stack of a run: read, changed, written at once, printed. A change that is refused leaves the file as it was.

use super::super::run_folder::RunFolder;
use super::super::shown::{EDITS, check_edits};
use super::super::{CliError, print_json};
use super::Target;
use crate::edit::{Edit, EditError, EditStack, Operation};
use crate::files::Work;
use crate::segment::segmentation::Segmentation;
use std::path::PathBuf;

/// A run's edits, to be changed.
pub(super) struct Edits {
    run: RunFolder,
    stack: EditStack,
    json: bool,
}

/// Which way to step.
#[derive(Clone, Copy)]
pub(super) enum Towards {
    Undo,
    Redo,
}

impl Edits {
    /// Reads the edits; none if there is no file yet.
    pub(super) fn open(target: Target) -> Result<Self, CliError> {
        let mut edits = Self::cleared(target)?;
        edits.stack = edits.run.edits()?;
        Ok(edits)
    }

    /// The same to look at: others may write meanwhile.
    pub(super) fn look(target: Target) -> Result<Self, CliError> {
        let (_, device) = target.common.device()?;
        let run = RunFolder::open(&target.run, &device)?;
        let stack = run.edits()?;
        Ok(Self { run, stack, json: target.common.json })
    }

    /// No edits, whatever the file holds.
    pub(super) fn cleared(target: Target) -> Result<Self, CliError> {
        let (_, device) = target.common.device()?;
        let run = RunFolder::open_to_write(&target.run, &device, Work::Short)?;
        Ok(Self { run, stack: EditStack::default(), json: target.common.json })
    }

    /// Adds an edit.
    pub(super) fn push(mut self, segments: Vec<String>, operation: Operation) -> Result<(), CliError> {
        let all = self.run.segments()?;
        let edit = Edit { segments, operation };
        check_names(&all, &edit)?;
        // an edit on top of one that cannot be applied would bury it
        check_edits(&self.run, &self.stack, &all)?;
        self.stack.push(edit).map_err(|e| match e {
            // the fields of an edit are called as the options are
            EditError::Value { field, problem } => {
                CliError::input(format!("--{}: {problem}", field.rsplit('.').next().unwrap_or(&field)))
            }
            other => CliError::input(other),
        })?;
        self.save()
    }

    /// Undoes or redoes `count` edits, all of them or none.
    pub(super) fn step(mut self, towards: Towards, count: usize) -> Result<(), CliError> {
        let there = match towards {
            Towards::Undo => self.stack.operations.len(),
            Towards::Redo => self.stack.undone.len(),
        };
        let what = match towards {
            Towards::Undo => "undo",
            Towards::Redo => "redo",
        };
        if there == 0 {
            return Err(CliError::input(format!("nothing to {what} in {}", self.path().display())));
        }
        if count > there {
            return Err(CliError::input(format!(
                "--count {count}: between 1 and {there}, as many as there are to {what}"
            )));
        }
        let all = matches!(towards, Towards::Redo).then(|| self.run.segments()).transpose()?;
        for _ in 0..count {
            match towards {
                Towards::Undo => drop(self.stack.undo()),
                Towards::Redo => {
                    if let (Some(edit), Some(all)) = (self.stack.redo(), &all) {
                        check_names(all, edit)?;
                    }
                }
            }
        }
        self.save()
    }

    /// Writes the stack and prints it.
    pub(super) fn save(self) -> Result<(), CliError> {
        self.stack.save(&self.path()).map_err(CliError::failure)?;
        self.print()
    }

    /// Prints the stack.
    pub(super) fn print(self) -> Result<(), CliError> {
        if self.json {
            return print_json(&self.stack);
        }
        let lines = self.stack.list();
        if lines.is_empty() {
            outln!("no edits");
        }
        for line in lines {
            outln!("{line}");
        }
        Ok(())
    }

    fn path(&self) -> PathBuf {
        self.run.path.join(EDITS)
    }
}

/// Refuses names that no segment has, and segments without Gaussians.
fn check_names(all: &Segmentation, edit: &Edit) -> Result<(), CliError> {
    for name in &edit.segments {
        let segment = all.get(name).map_err(|e| CliError::input(format!("cannot {edit}: {e}")))?;
        if segment.members.is_empty() {
            return Err(CliError::input(format!("cannot {edit}: segment \"{name}\" holds no Gaussians")));
        }
    }
    Ok(())
}
