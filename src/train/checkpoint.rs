//! Checkpoints: everything that a run needs to go on as if it had never stopped.
//!
//! `checkpoints/step-NNNNNN/{scene,optimizer}.safetensors` and `state.json`, written to a temporary folder
//! and renamed, so that a checkpoint is either whole or not there.

use super::Trainer;
use super::densify::Statistics;
use crate::files::{AtomicDir, write_atomic};
use crate::model::Scene;
use crate::model::params::HostTensor;
use crate::model::scene::{SceneError, read_tensors, write_tensors};
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
    /// The checkpoint belongs to other data or another configuration.
    #[error("{path}: {what} differs from that of the checkpoint; resume with the same, or train into a new folder")]
    Mismatch {
        /// The checkpoint.
        path: PathBuf,
        /// `the configuration` or `the dataset`.
        what: &'static str,
    },
}

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
    write_tensors(&dir.dir().join("optimizer.safetensors"), &tensors, &[])?;
    let json = serde_json::to_vec_pretty(state).map_err(|e| file_error(&e))?;
    write_atomic(&dir.dir().join("state.json"), &json).map_err(|e| file_error(&e))?;
    dir.commit_replacing().map_err(|e| file_error(&e))?;
    let all = list(run);
    for (_, old) in all.iter().take(all.len().saturating_sub(keep.max(1))) {
        // renamed first: a kill in the middle leaves a temporary, never half a checkpoint
        let doomed = old.with_file_name(format!(".tmp-{}-{}-0", folder_of(old), std::process::id()));
        std::fs::rename(old, &doomed).and_then(|()| std::fs::remove_dir_all(&doomed)).map_err(|e| file_error(&e))?;
    }
    Ok(path)
}

fn folder_of(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Takes a trainer, new from the same configuration and data, to where the checkpoint was.
///
/// # Errors
/// If a file is missing or damaged, or the configuration or the dataset is another.
pub fn restore(path: &Path, trainer: &mut Trainer, config: &str, dataset: &str) -> Result<State, CheckpointError> {
    let state_path = path.join("state.json");
    let bad = |reason: String| CheckpointError::File { path: state_path.clone(), reason };
    let text = std::fs::read_to_string(&state_path).map_err(|e| bad(e.to_string()))?;
    let state: State = serde_json::from_str(&text).map_err(|e| bad(e.to_string()))?;
    for (what, same) in [("the configuration", state.config == config), ("the dataset", state.dataset == dataset)] {
        if !same {
            return Err(CheckpointError::Mismatch { path: path.into(), what });
        }
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
    trainer.optimizer.load(&tensors, &device.inner());
    trainer.sleep.load(&tensors, n);
    trainer.scene = Some(scene);
    trainer.step = state.step;
    trainer.initial = state.initial;
    Ok(state)
}
