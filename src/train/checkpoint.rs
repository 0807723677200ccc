//! Checkpoints: everything that a run needs to go on as if it had never stopped.
//!
//! `checkpoints/step-NNNNNN/{scene,optimizer}.safetensors` and `state.json`, written to a temporary folder
//! and renamed, so that a checkpoint is either whole or not there.

use super::Trainer;
use super::densify::Statistics;
use super::resume::{self, Change};
use crate::files::{AtomicDir, FolderKind, ReplaceError, remove_whole, write_atomic};
use crate::model::Scene;
use crate::model::params::{self, HostTensor};
use crate::model::scene::{SceneError, read_tensors, write_tensors};
use crate::tensors;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Why a checkpoint cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// A tensor file.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// Another file or the folder.
    #[error("{path}: {reason}")]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A checkpoint is not whole any more.
    #[error("{reason}; {advice}")]
    Damaged {
        /// What is wrong, with the file.
        reason: String,
        /// The way out, as a command where there is one.
        advice: String,
    },
    /// The checkpoint belongs to other data.
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
    /// Keys were changed that shaped the steps already taken.
    #[error("{path}: {}; resume without that, or train into a new folder", listed(changes))]
    Changed {
        /// The checkpoint.
        path: PathBuf,
        /// The keys.
        changes: Vec<Change>,
    },
    /// There is nothing to go on from.
    #[error("{run}: no checkpoint to go on from{hint}; without --resume training begins anew")]
    None {
        /// The run.
        run: PathBuf,
        /// What there is instead.
        hint: String,
    },
    /// Another folder stands where the checkpoint should go.
    #[error(transparent)]
    Replace(#[from] ReplaceError),
}

fn listed(changes: &[Change]) -> String {
    changes.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

/// The folder of a checkpoint.
const KIND: FolderKind = FolderKind {
    what: "a checkpoint",
    markers: &["state.json"],
    entries: &["scene.safetensors", "optimizer.safetensors"],
};

/// What is not a tensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// Steps taken.
    pub step: usize,
    /// Gaussians at the start of the run.
    pub initial: usize,
    /// Fingerprint of the dataset.
    pub dataset: String,
    /// The resolved configuration, TOML.
    pub config: String,
    /// Seconds of training so far.
    pub seconds: f64,
}

/// Name of the checkpoint after `step` steps.
pub fn folder_name(step: usize) -> String {
    format!("step-{step:06}")
}

/// Complete checkpoints in a run folder, oldest first.
pub fn list(run: &Path) -> Vec<(usize, PathBuf)> {
    let Ok(entries) = std::fs::read_dir(run.join("checkpoints")) else { return Vec::new() };
    let mut found: Vec<(usize, PathBuf)> = entries
        .flatten()
        .filter_map(|e| {
            let step = e.file_name().to_str()?.strip_prefix("step-")?.parse().ok()?;
            e.path().join("state.json").is_file().then(|| (step, e.path()))
        })
        .collect();
    found.sort();
    found
}

/// The scene file of the newest checkpoint of a run.
pub fn newest_scene(run: &Path) -> Option<PathBuf> {
    list(run).pop().map(|(_, path)| path.join("scene.safetensors"))
}

/// The run and the checkpoint that `path` stands for: a run folder with its newest checkpoint, if it has one, or one of
/// its checkpoints.
pub fn locate(path: &Path) -> (PathBuf, Option<PathBuf>) {
    let run = path.parent().filter(|p| p.file_name().is_some_and(|n| n == "checkpoints")).and_then(Path::parent);
    match run {
        Some(run) if path.join("state.json").is_file() => {
            let run = if run.as_os_str().is_empty() { Path::new(".") } else { run };
            (run.to_owned(), Some(path.to_owned()))
        }
        _ => (path.to_owned(), list(path).pop().map(|(_, newest)| newest)),
    }
}

/// What to do when the checkpoint at `path` is damaged: the newest older one that is whole, as a command would name it.
pub fn advice(path: &Path) -> String {
    let (run, _) = locate(path);
    let whole = |checkpoint: &Path| {
        let read = std::fs::read(checkpoint.join("state.json")).ok();
        read.is_some_and(|text| serde_json::from_slice::<State>(&text).is_ok())
            && ["scene.safetensors", "optimizer.safetensors"].iter().all(|f| tensors::read(&checkpoint.join(f)).is_ok())
    };
    let name = path.file_name();
    let older = list(&run).into_iter().rev().map(|(_, p)| p).skip_while(|p| p.file_name() != name).skip(1);
    match older.into_iter().find(|p| whole(p)) {
        Some(older) => format!(
            "an older checkpoint is whole: give {} in place of {}, or train on from it with `volseggs train --resume {}`",
            older.display(),
            run.display(),
            older.display()
        ),
        None => "no older checkpoint is whole; restore the file from a copy, or train again".to_owned(),
    }
}

/// Takes checkpoints newer than `path` out of the way, as training goes on from there: they stay beside it under
/// `aside-step-NNNNNN`.
///
/// # Errors
/// If one cannot be renamed.
pub fn set_newer_aside(run: &Path, path: &Path) -> Result<(), CheckpointError> {
    for (step, newer) in list(run).into_iter().rev().take_while(|(_, p)| p.file_name() != path.file_name()) {
        let aside = |k: usize| {
            let number = if k == 0 { String::new() } else { format!("-{k}") };
            newer.with_file_name(format!("aside-{}{number}", folder_name(step)))
        };
        let free = (0..).map(aside).find(|p| p.symlink_metadata().is_err());
        let moved = free.map_or(Ok(()), |free| std::fs::rename(&newer, free));
        moved.map_err(|e| CheckpointError::File { path: newer.clone(), reason: e.to_string() })?;
    }
    Ok(())
}

/// Writes a checkpoint and removes all but the `keep` newest.
///
/// # Errors
/// If a file cannot be written; nothing half-written is left under a final name.
pub fn save(run: &Path, trainer: &Trainer, state: &State, keep: usize) -> Result<PathBuf, CheckpointError> {
    let path = run.join("checkpoints").join(folder_name(state.step));
    let file_error = |e: &dyn std::fmt::Display| CheckpointError::File { path: path.clone(), reason: e.to_string() };
    std::fs::create_dir_all(run.join("checkpoints")).map_err(|e| file_error(&e))?;
    let dir = AtomicDir::create(&path).map_err(|e| file_error(&e))?;
    trainer.scene().save(&dir.dir().join("scene.safetensors"))?;
    let mut tensors = trainer.optimizer.to_tensors();
    tensors.extend(trainer.sleep.to_tensors());
    let s = trainer.statistics.to_host();
    for (name, values) in [("gradient", &s.gradient), ("views", &s.views), ("opacity", &s.opacity)] {
        let tensor = HostTensor { shape: vec![values.len()], values: values.clone() };
        tensors.insert(format!("statistics.{name}"), tensor);
    }
    write_tensors(&dir.dir().join("optimizer.safetensors"), &tensors, None)?;
    let json = serde_json::to_vec_pretty(state).map_err(|e| file_error(&e))?;
    write_atomic(&dir.dir().join("state.json"), &json).map_err(|e| file_error(&e))?;
    dir.commit_replacing(&KIND, &[])?;
    let all = list(run);
    for (_, old) in all.iter().take(all.len().saturating_sub(keep.max(1))) {
        remove_whole(old).map_err(|e| file_error(&e))?;
    }
    Ok(path)
}

/// Takes a trainer, new from the same data and a configuration that may differ in what [`resume`] allows, to where the
/// checkpoint was. Gives the keys that differ.
///
/// # Errors
/// If a file is missing or damaged, or the configuration or the dataset is another.
pub fn restore(
    path: &Path,
    trainer: &mut Trainer,
    config: &str,
    dataset: &str,
) -> Result<(State, Vec<Change>), CheckpointError> {
    restore_whole(path, trainer, config, dataset).map_err(|e| {
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
    trainer: &mut Trainer,
    config: &str,
    dataset: &str,
) -> Result<(State, Vec<Change>), CheckpointError> {
    let state_path = path.join("state.json");
    let bad = |reason: String| CheckpointError::File { path: state_path.clone(), reason };
    let text = std::fs::read_to_string(&state_path).map_err(|e| bad(e.to_string()))?;
    let state: State = serde_json::from_str(&text).map_err(|e| bad(e.to_string()))?;
    if state.dataset != dataset {
        return Err(CheckpointError::Dataset { path: path.into(), was: state.dataset, now: dataset.to_owned() });
    }
    let (allowed, refused) = resume::changes(&state.config, config, state.step).map_err(bad)?;
    if !refused.is_empty() {
        return Err(CheckpointError::Changed { path: path.into(), changes: refused });
    }
    let device = trainer.device().clone();
    let scene = Scene::load(&path.join("scene.safetensors"), &device)?;
    let n = scene.gaussians.count();
    let tensors_path = path.join("optimizer.safetensors");
    let (tensors, _) = read_tensors(&tensors_path)?;
    let statistic = |name: &str| {
        let values = tensors.get(&format!("statistics.{name}")).map(|t| t.values.clone());
        values.filter(|v| v.len() == n).ok_or_else(|| CheckpointError::File {
            path: tensors_path.clone(),
            reason: format!("statistics.{name} is missing or has not {n} entries"),
        })
    };
    let statistics =
        Statistics { gradient: statistic("gradient")?, views: statistic("views")?, opacity: statistic("opacity")? };
    trainer.statistics.replace(|_| statistics);
    let sizes = params::sizes(&scene);
    let loaded = trainer.optimizer.load(&tensors, &sizes, &device.inner());
    loaded.map_err(|reason| CheckpointError::File { path: tensors_path.clone(), reason })?;
    trainer.sleep.load(&tensors, n);
    trainer.scene = Some(scene);
    trainer.step = state.step;
    trainer.initial = state.initial;
    Ok((state, allowed))
}
