//! Paths of all files and folders of a run, in one place; `checkpoints/README.md` describes what they hold.

use std::path::{Path, PathBuf};

/// The files and folders within a run folder.
#[derive(Clone, Copy, Debug)]
pub struct RunPaths<'a>(pub &'a Path);

impl RunPaths<'_> {
    /// Name of the folder of checkpoints, which distinguishes a checkpoint's path from a run's.
    pub const CHECKPOINTS: &'static str = "checkpoints";
    /// Name of the scene within a checkpoint.
    pub const SCENE: &'static str = "scene.safetensors";

    /// The record, by which a folder is recognised as a run.
    pub fn record(self) -> PathBuf {
        self.0.join("run.json")
    }

    /// The resolved configuration.
    pub fn config(self) -> PathBuf {
        self.0.join("config.toml")
    }

    /// The metrics that training logs, one line each.
    pub fn metrics(self) -> PathBuf {
        self.0.join("metrics.jsonl")
    }

    /// The folder of TensorBoard's event files.
    pub fn tensorboard(self) -> PathBuf {
        self.0.join("tensorboard")
    }

    /// The folder of checkpoints.
    pub fn checkpoints(self) -> PathBuf {
        self.0.join(Self::CHECKPOINTS)
    }

    /// The folder of measurements, each in a folder of its own.
    pub fn eval(self) -> PathBuf {
        self.0.join("eval")
    }

    /// The segments, with their history.
    pub fn segments(self) -> PathBuf {
        self.0.join("segments/segments.safetensors")
    }

    /// The masks that the affinity field is trained on.
    pub fn masks(self) -> PathBuf {
        self.0.join("segments/masks.jsonl")
    }

    /// The folder of pictures from which another program makes masks.
    pub fn mask_pictures(self) -> PathBuf {
        self.0.join("segments/pictures")
    }

    /// The affinity field.
    pub fn affinity(self) -> PathBuf {
        self.0.join("segments/affinity.safetensors")
    }

    /// A picture of segments, for users.
    pub fn segment_sheet(self, name: &str) -> PathBuf {
        self.0.join(format!("segments/{name}.png"))
    }

    /// The edits.
    pub fn edits(self) -> PathBuf {
        self.0.join("edits.json")
    }

    /// The folder of tracks, each in a folder of its own.
    pub fn tracks(self) -> PathBuf {
        self.0.join("track")
    }

    /// The default folder of exported Gaussians.
    pub fn exported(self) -> PathBuf {
        self.0.join("export")
    }

    /// The default folder of label volumes.
    pub fn labels(self) -> PathBuf {
        self.0.join("labels")
    }
}
