//! Checkpoints: everything that a run needs to continue as if it had never stopped.
//!
//! `checkpoints/step-NNNNNN/{scene,optimizer}.safetensors` and `state.json`, written to a temporary folder and renamed,
//! so that a checkpoint is either complete or absent.

use super::resume::{self, ChangedKey};
use super::{SavedTraining, Training};
use crate::files::{AtomicDir, FolderKind, ReplaceError, RunPaths, remove_whole, write_atomic};
use crate::model::Scene;
use crate::model::scene_file::{SceneError, read_tensors, refuse_not_finite, write_tensors};
use crate::shell;
use crate::versioned;
use serde::{Deserialize, Serialize};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Why a checkpoint cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// A tensor file cannot be written or read.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// Another file or the folder cannot be written or read.
    #[error("{path}: {reason}")]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A checkpoint is no longer complete.
    #[error("{reason}; {advice}")]
    Damaged {
        /// What is wrong, with the file.
        reason: String,
        /// The remedy, as a command where there is one.
        advice: String,
    },
    /// The checkpoint belongs to another dataset.
    #[error(
        "{path}: trained on another dataset ({was}, this one is {now}); point to the one it was trained on with --data, or train \
         into a new folder"
    )]
    Dataset {
        /// The checkpoint.
        path: PathBuf,
        /// Fingerprint of its dataset.
        was: String,
        /// Fingerprint of the dataset given.
        now: String,
    },
    /// Keys that shaped the steps already taken were changed.
    #[error("{path}: {}; resume without these changes, or train into a new folder", listed(changes))]
    Changed {
        /// The checkpoint.
        path: PathBuf,
        /// The keys.
        changes: Vec<ChangedKey>,
    },
    /// The state that only training needs is missing.
    #[error("{path}: is packed, without the state that training needs; resume the run that it was packed from")]
    Packed {
        /// The checkpoint.
        path: PathBuf,
    },
    /// There is no checkpoint to resume from.
    #[error("{run}: no checkpoint to resume from; train without --resume to start over")]
    None {
        /// The run.
        run: PathBuf,
    },
    /// Another folder is in the place of the checkpoint.
    #[error(transparent)]
    Replace(#[from] ReplaceError),
}

fn listed(changes: &[ChangedKey]) -> String {
    changes.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

/// The folder of a checkpoint.
const KIND: FolderKind = FolderKind { what: "a checkpoint", markers: &[STATE], entries: &[RunPaths::SCENE, OPTIMIZER] };

/// The file of everything but tensors, see [`CheckpointState`].
const STATE: &str = "state.json";
/// The file of the tensors that only training needs.
const OPTIMIZER: &str = "optimizer.safetensors";

/// Everything in a checkpoint but its tensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CheckpointState {
    /// Steps taken.
    pub step: usize,
    /// Primitives at the start of the run, see [`Training::first_primitives`].
    pub initial: usize,
    /// Fingerprint of the dataset.
    pub dataset: String,
    /// The resolved configuration, TOML.
    pub config: String,
    /// Seconds of training so far.
    pub seconds: f64,
    /// Whether the scene is packed and what only training needs is omitted: it can be viewed, but not trained further.
    pub packed: bool,
}

/// Returns the name of the checkpoint after `step` steps.
pub fn folder_name(step: usize) -> String {
    format!("step-{step:06}")
}

/// Returns the step of the checkpoint in that folder, from its name.
pub fn step_of(path: &Path) -> Option<usize> {
    path.file_name()?.to_str()?.strip_prefix("step-")?.parse().ok()
}

/// Lists the complete checkpoints in a run folder, oldest first; none if the folder cannot be read, see [`newest`].
pub fn list(run: &Path) -> Vec<(usize, PathBuf)> {
    let mut found = folders(run).unwrap_or_default();
    found.retain(|(_, path)| path.join(STATE).is_file());
    found
}

/// Lists the checkpoint folders of a run, complete or not, oldest first.
fn folders(run: &Path) -> Result<Vec<(usize, PathBuf)>, CheckpointError> {
    let path = RunPaths(run).checkpoints();
    let wrong = |e: std::io::Error| CheckpointError::File { path: path.clone(), reason: e.to_string() };
    let entries = match std::fs::read_dir(&path) {
        Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => return Ok(Vec::new()),
        entries => entries.map_err(wrong)?,
    };
    let mut found = Vec::new();
    for entry in entries {
        let entry = entry.map_err(wrong)?;
        let path = entry.path();
        found.extend(step_of(&path).map(|step| (step, path)));
    }
    found.sort();
    Ok(found)
}

/// Returns the newest checkpoint of a run, if it has one.
///
/// # Errors
/// [`CheckpointError::Damaged`] if it is incomplete: checkpoints appear complete, so a part of it was lost since.
/// [`CheckpointError::File`] if the folder cannot be read.
pub fn newest(run: &Path) -> Result<Option<PathBuf>, CheckpointError> {
    let Some((_, path)) = folders(run)?.pop() else { return Ok(None) };
    // all that is needed to show it; the state of the optimiser is missed by what trains further
    match [STATE, RunPaths::SCENE].into_iter().find(|name| !path.join(name).is_file()) {
        // a training removes old checkpoints, renaming them first
        Some(_) if !path.exists() => Ok(list(run).pop().map(|(_, path)| path)),
        Some(name) => Err(CheckpointError::Damaged {
            reason: format!("{}: {name} is missing", path.display()),
            advice: advice(&path),
        }),
        None => Ok(Some(path)),
    }
}

/// Returns the scene file of the newest checkpoint of a run.
pub fn newest_scene(run: &Path) -> Option<PathBuf> {
    list(run).pop().map(|(_, path)| path.join(RunPaths::SCENE))
}

/// Returns the run and the checkpoint that `path` refers to: a run folder with its newest checkpoint, if it has one, or
/// one of its checkpoints.
pub fn locate(path: &Path) -> (PathBuf, Option<PathBuf>) {
    let run =
        path.parent().filter(|p| p.file_name().is_some_and(|n| n == RunPaths::CHECKPOINTS)).and_then(Path::parent);
    match run {
        Some(run) if path.join(STATE).is_file() => {
            let run = if run.as_os_str().is_empty() { Path::new(".") } else { run };
            (run.to_owned(), Some(path.to_owned()))
        }
        _ => (path.to_owned(), list(path).pop().map(|(_, newest)| newest)),
    }
}

/// Reads the tensors of the checkpoint at `path`: the scene and, unless it is packed, the state of the optimiser.
///
/// # Errors
/// If a file cannot be read, or holds values that are not finite.
pub fn check_tensors(path: &Path) -> Result<(), SceneError> {
    let is_packed = read_state(path).is_ok_and(|state| state.packed);
    [RunPaths::SCENE, OPTIMIZER][..if is_packed { 1 } else { 2 }].iter().try_for_each(|name| {
        let file = path.join(name);
        refuse_not_finite(&file, &read_tensors(&file)?.0)
    })
}

/// Returns what to do when the checkpoint at `path` is damaged, naming the newest older one that is complete as a
/// command would.
pub fn advice(path: &Path) -> String {
    let run = path.parent().and_then(Path::parent).unwrap_or_else(|| Path::new("."));
    let whole = |checkpoint: &Path| read_state(checkpoint).is_ok() && check_tensors(checkpoint).is_ok();
    let before = step_of(path).unwrap_or(usize::MAX);
    let older = list(run).into_iter().rev().filter(|(step, _)| *step < before).map(|(_, p)| p);
    match older.into_iter().find(|p| whole(p)) {
        Some(older) => format!(
            "an older checkpoint is intact: give {} in place of {}, or continue training from it with \
             `volseggs train --resume {}`",
            older.display(),
            run.display(),
            shell::path(&older)
        ),
        None => "no older checkpoint is intact; restore the file from a copy, or train again".to_owned(),
    }
}

/// Sets aside the checkpoints after `step`, complete or not, as training continues from there: they stay beside it
/// under `aside-step-NNNNNN`. Returns their number.
///
/// # Errors
/// If one cannot be renamed.
pub fn set_newer_aside(run: &Path, step: usize) -> Result<usize, CheckpointError> {
    let newer: Vec<PathBuf> = folders(run)?.into_iter().filter(|(s, _)| *s > step).map(|(_, path)| path).collect();
    newer.iter().try_for_each(|path| set_aside(path))?;
    Ok(newer.len())
}

/// Renames a checkpoint so that it no longer counts as one.
fn set_aside(path: &Path) -> Result<(), CheckpointError> {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let aside = |k: usize| {
        let number = if k == 0 { String::new() } else { format!("-{k}") };
        path.with_file_name(format!("aside-{name}{number}"))
    };
    let free = (0..).map(aside).find(|p| p.symlink_metadata().is_err());
    let moved = free.map_or(Ok(()), |free| std::fs::rename(path, free));
    moved.map_err(|e| CheckpointError::File { path: path.into(), reason: e.to_string() })
}

/// Reads the state of a checkpoint besides its tensors.
///
/// # Errors
/// If its file is missing or damaged.
pub fn read_state(checkpoint: &Path) -> Result<CheckpointState, CheckpointError> {
    let path = checkpoint.join(STATE);
    let bad = |e: &dyn std::fmt::Display| CheckpointError::File { path: path.clone(), reason: e.to_string() };
    let text = std::fs::read_to_string(&path).map_err(|e| bad(&e))?;
    versioned::from_json(&text).map_err(|e| bad(&e))
}

/// Writes the viewable part of `checkpoint` into `run`, a folder not yet visible to others: `scene`, which is its
/// scene, packed. Returns the scene file.
///
/// # Errors
/// If a file cannot be read or written.
pub fn save_packed(run: &Path, scene: &Scene, checkpoint: &Path) -> Result<PathBuf, CheckpointError> {
    let state = CheckpointState { packed: true, ..read_state(checkpoint)? };
    let path = RunPaths(run).checkpoints().join(folder_name(state.step));
    let bad = |e: &dyn std::fmt::Display| CheckpointError::File { path: path.clone(), reason: e.to_string() };
    std::fs::create_dir_all(&path).map_err(|e| bad(&e))?;
    let file = path.join(RunPaths::SCENE);
    scene.save_packed(&file)?;
    let json = versioned::to_json_pretty(&state).map_err(|e| bad(&e))?;
    write_atomic(&path.join(STATE), &json).map_err(|e| bad(&e))?;
    Ok(file)
}

/// Writes a checkpoint and removes all but the `keep` newest.
///
/// # Errors
/// If a file cannot be written, or a moment is not finite; nothing incomplete is left under a final name.
pub fn save(
    run: &Path,
    training: &dyn Training,
    state: &CheckpointState,
    keep: usize,
) -> Result<PathBuf, CheckpointError> {
    let path = RunPaths(run).checkpoints().join(folder_name(state.step));
    let file_error = |e: &dyn std::fmt::Display| CheckpointError::File { path: path.clone(), reason: e.to_string() };
    std::fs::create_dir_all(RunPaths(run).checkpoints()).map_err(|e| file_error(&e))?;
    let dir = AtomicDir::create(&path).map_err(|e| file_error(&e))?;
    training.model().save(&dir.dir().join(RunPaths::SCENE))?;
    // on a GPU losses and gradients are read only now and then; non-finite values show in the moments too
    let moments = training.state();
    refuse_not_finite(&path.join(OPTIMIZER), &moments)?;
    write_tensors(&dir.dir().join(OPTIMIZER), &moments, None)?;
    let json = versioned::to_json_pretty(state).map_err(|e| file_error(&e))?;
    write_atomic(&dir.dir().join(STATE), &json).map_err(|e| file_error(&e))?;
    dir.commit_replacing(&KIND, &[])?;
    let all = list(run);
    for (_, old) in all.iter().take(all.len().saturating_sub(keep.max(1))) {
        // one in which a user keeps other files is set aside instead
        match KIND.check(old, &[]) {
            Ok(()) => remove_whole(old).map_err(|e| file_error(&e))?,
            Err(_) => set_aside(old)?,
        }
    }
    Ok(path)
}

/// Restores a checkpoint into a training newly created from the same data and a configuration that may differ in what
/// [`resume`] allows. Returns the state and the keys that differ.
///
/// # Errors
/// If a file is missing or damaged, or the configuration or the dataset does not match.
pub fn restore(
    path: &Path,
    training: &mut dyn Training,
    config: &str,
    dataset: &str,
) -> Result<(CheckpointState, Vec<ChangedKey>), CheckpointError> {
    restore_whole(path, training, config, dataset).map_err(|e| {
        let reason = match &e {
            CheckpointError::File { .. } => e.to_string(),
            CheckpointError::Scene(error) if error.is_damage() => e.to_string(),
            _ => return e,
        };
        CheckpointError::Damaged { reason, advice: advice(path) }
    })
}

fn restore_whole(
    path: &Path,
    training: &mut dyn Training,
    config: &str,
    dataset: &str,
) -> Result<(CheckpointState, Vec<ChangedKey>), CheckpointError> {
    let state = read_state(path)?;
    let bad = |reason: String| CheckpointError::File { path: path.join(STATE), reason };
    if state.packed {
        return Err(CheckpointError::Packed { path: path.into() });
    }
    // keys first, as some of them are part of the dataset's fingerprint
    let (allowed, refused) = resume::changes(&state.config, config, state.step).map_err(bad)?;
    if !refused.is_empty() {
        return Err(CheckpointError::Changed { path: path.into(), changes: refused });
    }
    if state.dataset != dataset {
        return Err(CheckpointError::Dataset { path: path.into(), was: state.dataset, now: dataset.to_owned() });
    }
    let state_path = path.join(OPTIMIZER);
    if !state_path.exists() {
        return Err(CheckpointError::File {
            reason: "is missing: the scene can be used, but not trained further without it".to_owned(),
            path: state_path,
        });
    }
    let (tensors, _) = read_tensors(&state_path)?;
    training.resume(SavedTraining {
        model: &path.join(RunPaths::SCENE),
        state: tensors,
        state_path: &state_path,
        step: state.step,
        first_primitives: state.initial,
    })?;
    Ok((state, allowed))
}
