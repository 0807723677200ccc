//! The record of how a dataset was prepared.

use crate::data::Calibration;
use crate::files::read_text;
use crate::words::plain;
use serde::{Deserialize, Serialize};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The name of the record's file in the folder of its dataset.
pub(super) const FILE: &str = "prepare.json";

/// The record of a dataset, `prepare.json`: what it was made from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PrepareRecord {
    /// Version of the program.
    pub version: String,
    /// What was rendered.
    pub source: String,
    /// Name of the transfer function, which is stored beside it as `transfer-function.toml`.
    pub transfer_function: String,
    /// Data values at its two ends.
    pub span: [f64; 2],
    /// Voxels along x, y, z.
    pub dims: [usize; 3],
    /// Half the size of the volume's box around the origin, scene units.
    pub half_size: [f64; 3],
    /// Distance between voxel centres along x, y, z, in the units of the files; missing in records of old versions.
    #[serde(default)]
    pub spacing: Option<[f64; 3]>,
    /// Position of the centre of the first voxel, in the units of the files; missing in records of old versions.
    #[serde(default)]
    pub origin: Option<[f64; 3]>,
    /// Physical space and time of the scene.
    #[serde(default)]
    pub calibration: Calibration,
    /// Number of steps of the series.
    pub steps: usize,
    /// Time of each step in [0, 1] where they are not evenly spaced; missing in records of old versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub times: Option<Vec<f64>>,
    /// Distance between samples, in voxels.
    pub step: f64,
    /// Number of images of the training split.
    pub train_views: usize,
    /// Number of images of the test split.
    pub test_views: usize,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Names of the segments, if any are known.
    pub segments: Vec<String>,
    /// Times in [0, 1] that training sees and whose training images are all empty; missing in records of old versions.
    #[serde(default)]
    pub empty_times: Vec<f64>,
    /// Total time, seconds.
    pub seconds: f64,
    /// Of these, seconds spent reading volumes and laying them out.
    pub load_seconds: f64,
    /// Peak memory of the process, bytes; 0 where unknown.
    pub peak_memory_bytes: u64,
}

/// The error for a record that cannot be read.
#[derive(Debug, Error)]
#[error("{}: {problem}", path.display())]
pub struct RecordError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong with it.
    pub problem: String,
}

impl PrepareRecord {
    /// Reads the record of the dataset in `folder`; `None` for a dataset from elsewhere, or a missing folder.
    ///
    /// # Errors
    /// A file that cannot be read or is not such a record.
    pub fn read(folder: &Path) -> Result<Option<Self>, RecordError> {
        let path = folder.join(FILE);
        let read = match read_text(&path) {
            Ok(text) => serde_json::from_str(&text).map(Some).map_err(|e| e.to_string()),
            Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => Ok(None),
            Err(e) => Err(e.to_string()),
        };
        read.map_err(|e| RecordError { problem: plain(&e), path })
    }
}
