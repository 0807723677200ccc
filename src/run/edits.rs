//! Changes to a run's edits. A change that is refused leaves them unchanged.

use super::segments::{HistoryDirection, check_count};
use super::selection::{Selection, check_edits};
use super::{OpenRun, RunError};
use crate::edit::{Edit, EditError, EditStack};
use crate::segment::segmentation::Segmentation;
use crate::shell;
use glam::DVec3;

/// Adds an edit and writes the file of edits. Returns them with a note if the edit moves its segments out of the scene.
///
/// # Errors
/// If the edit names a segment that does not exist, has a value out of range (the error names the option of that name),
/// or cannot be written, or if an earlier edit can no longer be applied.
pub fn push(run: &OpenRun, edit: Edit) -> Result<(EditStack, Option<String>), RunError> {
    let mut stack = run.edits()?;
    let all = run.segments()?;
    check_names(&all, &edit)?;
    // adding an edit after one that cannot be applied would bury the problem
    check_edits(run, &stack, &all)?;
    let line = edit.line(run.calibration());
    let (moves, names) = (edit.operation.moves(), edit.segments.clone());
    stack.push(edit).map_err(|e| match e {
        // fields of an edit have the names of the options
        EditError::Value { field, problem } => {
            RunError::input(format!("--{}: {problem}", field.rsplit('.').next().unwrap_or(&field)))
        }
        other => RunError::input(other),
    })?;
    let stack = save(run, stack)?;
    // the edit is made, whatever can be said of it
    let outside = moves && is_outside(run, &names).unwrap_or(false);
    let note = outside.then(|| {
        format!(
            "{line}: with this edit, the centre of what it moves is outside the box of the scene at all times, where \
             pictures may not show it; `volseggs edit undo {}` takes it back",
            shell::path(&run.path)
        )
    });
    Ok((stack, note))
}

/// Whether the centre of the segments, with all edits, is outside the scene's box at the first, middle and last time.
fn is_outside(run: &OpenRun, names: &[String]) -> Result<bool, RunError> {
    let shown = Selection::open(run, names, true)?;
    let spec = &run.scene.spec;
    let half = DVec3::from_array(spec.half_size.map(f64::from));
    for time in [0.0, 0.5, 1.0] {
        let Some(centre) = shown.centre(&run.scene, time)? else { return Ok(false) };
        if (DVec3::from_array(centre) - spec.centre()).abs().cmple(half).all() {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Undoes or redoes `count` edits, all of them or none, and writes the file.
///
/// # Errors
/// If there are fewer, or an edit to be redone names a segment that no longer exists.
pub fn step(run: &OpenRun, towards: HistoryDirection, count: usize) -> Result<EditStack, RunError> {
    let mut stack = run.edits()?;
    let there = match towards {
        HistoryDirection::Undo => stack.operations.len(),
        HistoryDirection::Redo => stack.undone.len(),
    };
    check_count(towards, count, there, &run.paths().edits())?;
    let all = matches!(towards, HistoryDirection::Redo).then(|| run.segments()).transpose()?;
    for _ in 0..count {
        match towards {
            HistoryDirection::Undo => drop(stack.undo()),
            HistoryDirection::Redo => {
                if let (Some(edit), Some(all)) = (stack.redo(), &all) {
                    check_names(all, edit)?;
                }
            }
        }
    }
    save(run, stack)
}

/// Removes all edits, including those of a file that cannot be read.
///
/// # Errors
/// If the file cannot be written.
pub fn clear(run: &OpenRun) -> Result<EditStack, RunError> {
    save(run, EditStack::default())
}

fn save(run: &OpenRun, stack: EditStack) -> Result<EditStack, RunError> {
    stack.save(&run.paths().edits()).map_err(RunError::failure)?;
    Ok(stack)
}

/// Checks that the segments an edit names exist and have Gaussians.
///
/// # Errors
/// The first segment that does not.
pub(super) fn check_names(all: &Segmentation, edit: &Edit) -> Result<(), RunError> {
    for name in &edit.segments {
        let segment = all.get(name).map_err(|e| RunError::input(format!("cannot {edit}: {e}")))?;
        if segment.members.is_empty() {
            return Err(RunError::input(format!("cannot {edit}: segment \"{name}\" holds no Gaussians")));
        }
    }
    Ok(())
}
