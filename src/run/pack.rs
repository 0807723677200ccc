//! A small copy of a run, to be kept or passed on: its newest scene in 8 and 16 bits, with its segments, affinity field
//! and edits.

use super::{OpenRun, RunError};
use crate::files::{AtomicDir, FolderKind, RunPaths, write_atomic};
use crate::train::checkpoint;
use crate::versioned;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Kind of a packed run's folder, which the next one may replace.
const KIND: FolderKind = FolderKind {
    what: "a packed run",
    markers: &["run.json"],
    entries: &[
        ".lock",
        "config.toml",
        "edits.json",
        "segments/segments.safetensors",
        "segments/affinity.safetensors",
        "checkpoints/step-[0-9]*/state.json",
        "checkpoints/step-[0-9]*/scene.safetensors",
    ],
};

/// What was written.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PackedRun {
    /// The folder.
    pub run: PathBuf,
    /// Gaussians of the scene.
    pub gaussians: usize,
    /// Bytes of its scene file.
    pub scene_bytes: u64,
    /// Bytes of the scene file that it was packed from.
    pub scene_bytes_before: u64,
}

/// Writes a packed copy of `run` to `out`, which can be drawn, measured, segmented, tracked and edited like `run`, but
/// not trained further. It holds the packed newest scene and the segments, affinity field and edits, if any. Masks,
/// tracks, pictures, measurements and logs are omitted.
///
/// # Errors
/// If `run` is an older checkpoint, something other than an older packed run is at `out`, or a file cannot be read or
/// written; `out` is then unchanged.
pub fn pack(run: &OpenRun, out: &Path) -> Result<PackedRun, RunError> {
    if let Some(step) = run.older_step() {
        return Err(RunError::input(format!(
            "{step}: an older checkpoint, but segments and edits belong to the newest; give {}",
            run.path.display()
        )));
    }
    let size = |path: &Path| {
        let found = std::fs::metadata(path).map_err(|e| RunError::failure(format!("{}: {e}", path.display())))?;
        Ok::<_, RunError>(found.len())
    };
    let Some(from) = run.scene_path.parent() else {
        return Err(RunError::failure(format!("{}: is not in a checkpoint", run.scene_path.display())));
    };
    let dir = AtomicDir::create_replacing(out, &KIND, &[&run.path])?;
    let (old, new) = (run.paths(), RunPaths(dir.dir()));
    let scene = checkpoint::save_packed(dir.dir(), &run.scene, from).map_err(RunError::failure)?;
    let scene_bytes = size(&scene)?;
    // seen from the copy, the dataset is elsewhere
    let mut record = run.record.clone();
    if let Ok(dataset) = run.dataset() {
        record.set_dataset(out, &dataset);
    }
    let json = versioned::to_json_pretty(&record).map_err(RunError::failure)?;
    write_atomic(&new.record(), &json).map_err(|e| RunError::failure(format!("{}: {e}", new.record().display())))?;
    copy(&old.config(), &new.config())?;
    for (from, to) in [(old.segments(), new.segments()), (old.affinity(), new.affinity()), (old.edits(), new.edits())] {
        if from.try_exists().map_err(|e| RunError::failure(format!("{}: {e}", from.display())))? {
            copy(&from, &to)?;
        }
    }
    dir.commit_replacing(&KIND, &[&run.path])?;
    Ok(PackedRun {
        run: out.to_owned(),
        gaussians: run.scene.gaussians.count(),
        scene_bytes,
        scene_bytes_before: size(&run.scene_path)?,
    })
}

/// Copies a file, creating the folder of the copy if needed.
fn copy(from: &Path, to: &Path) -> Result<(), RunError> {
    let failed = |e: std::io::Error| RunError::failure(format!("{}: {e}", from.display()));
    if let Some(folder) = to.parent() {
        std::fs::create_dir_all(folder).map_err(failed)?;
    }
    std::fs::copy(from, to).map(drop).map_err(failed)
}
