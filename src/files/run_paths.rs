//! Where everything of a run lies, in one place; what the files hold is told in `checkpoints/README.md`.

use std::path::{Path, PathBuf};

/// The files and folders within a run folder.
#[derive(Clone, Copy, Debug)]
pub struct RunPaths<'a>(pub &'a Path);

impl RunPaths<'_> {
    /// Name of the folder of checkpoints, by which a checkpoint's path is told from a run's.
    pub const CHECKPOINTS: &'static str = "checkpoints";
    /// Name of the scene within a checkpoint.
    pub const SCENE: &'static str = "scene.safetensors";

    /// The record: by it a folder is known to be a run.
    #[must_use]
    pub fn record(self) -> PathBuf {
        self.0.join("run.json")
    }

    /// The resolved configuration.
    #[must_use]
    pub fn config(self) -> PathBuf {
        self.0.join("config.toml")
    }

    /// The lines that training logs.
    #[must_use]
    pub fn metrics(self) -> PathBuf {
        self.0.join("metrics.jsonl")
    }

    /// The folder of TensorBoard's event files.
    #[must_use]
    pub fn tensorboard(self) -> PathBuf {
        self.0.join("tensorboard")
    }

    /// The folder of checkpoints.
    #[must_use]
    pub fn checkpoints(self) -> PathBuf {
        self.0.join(Self::CHECKPOINTS)
    }

    /// The folder of measurements; each lies in one of its own.
    #[must_use]
    pub fn eval(self) -> PathBuf {
        self.0.join("eval")
    }

    /// The segments, with their history.
    #[must_use]
    pub fn segments(self) -> PathBuf {
        self.0.join("segments/segments.safetensors")
    }

    /// The masks that the affinity field is trained on.
    #[must_use]
    pub fn masks(self) -> PathBuf {
        self.0.join("segments/masks.jsonl")
    }

    /// The folder of pictures for another program to make masks of.
    #[must_use]
    pub fn mask_pictures(self) -> PathBuf {
        self.0.join("segments/pictures")
    }

    /// The affinity field.
    #[must_use]
    pub fn affinity(self) -> PathBuf {
        self.0.join("segments/affinity.safetensors")
    }

    /// A picture of segments to look at.
    #[must_use]
    pub fn segment_sheet(self, name: &str) -> PathBuf {
        self.0.join(format!("segments/{name}.png"))
    }

    /// The edits.
    #[must_use]
    pub fn edits(self) -> PathBuf {
        self.0.join("edits.json")
    }

    /// The folder of tracks; each lies in one of its own.
    #[must_use]
    pub fn tracks(self) -> PathBuf {
        self.0.join("track")
    }

    /// The folder of exported Gaussians that were given no other place.
    #[must_use]
    pub fn exported(self) -> PathBuf {
        self.0.join("export")
    }

    /// The folder of label volumes that were given no other place.
    #[must_use]
    pub fn labels(self) -> PathBuf {
        self.0.join("labels")
    }
}
