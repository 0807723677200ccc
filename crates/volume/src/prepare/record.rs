//! The record of how a dataset was prepared.

use crate::data::calibration::PREPARED;
use crate::data::{Calibration, Normalisation};
use crate::files::read_text;
use crate::versioned;
use crate::volume::directions::Directions;
use crate::volume::grid::Grid;
use crate::volume::placement::VoxelPlacement;
use crate::words::plain;
use serde::{Deserialize, Serialize};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The name of the record's file in the folder of its dataset.
pub(super) const FILE: &str = PREPARED;

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
    /// The files that were read, in order of time, without labels; empty for a synthetic scene.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub source_files: Vec<SourceFile>,
    /// Voxels along the index axes x, y, z.
    pub dims: [usize; 3],
    /// Distance between voxel centres along the index axes, in the unit of the files.
    pub spacing: [f64; 3],
    /// Physical position of the centre of the first voxel, in the unit of the files.
    pub origin: [f64; 3],
    /// Unit vectors of the index axes in physical space.
    pub directions: Directions,
    /// Length of the longest side of the volume along its index axes, scene units.
    pub side: f64,
    /// Half the size of the box that encloses the volume along the axes of the scene, centred at its origin, scene units.
    pub half_size: [f64; 3],
    /// Physical space and time of the scene.
    pub calibration: Calibration,
    /// Number of steps of the series.
    pub steps: usize,
    /// Time of each step in [0, 1] where they are not evenly spaced.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub times: Option<Vec<f64>>,
    /// Time of each step as the files or the user give it, in the unit of the calibration; `None` where it is unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_values: Option<Vec<f64>>,
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
    /// Times in [0, 1] that training sees and whose training images are all empty.
    pub empty_times: Vec<f64>,
    /// Total time, seconds.
    pub seconds: f64,
    /// Of these, seconds spent reading volumes and laying them out.
    pub load_seconds: f64,
    /// Peak memory of the process, bytes; 0 where unknown.
    pub peak_memory_bytes: u64,
}

/// A file from which a dataset was made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SourceFile {
    /// The path as it was given, or found in a folder or by a pattern that was.
    pub given: PathBuf,
    /// The same from the root of the file system.
    pub absolute: PathBuf,
}

impl SourceFile {
    pub(super) fn new(given: &Path) -> Self {
        let absolute = std::path::absolute(given).unwrap_or_else(|_| given.to_owned());
        Self { given: given.to_owned(), absolute }
    }
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
    /// The grid of the volumes.
    pub fn grid(&self) -> Grid {
        Grid { dims: self.dims, spacing: self.spacing, origin: self.origin, directions: self.directions }
    }

    /// Where the voxels of the volumes are in the scene.
    pub fn placement(&self) -> VoxelPlacement {
        VoxelPlacement::new(&self.grid(), self.side)
    }

    /// The same record with lengths in the units of a scene that was trained on the dataset.
    #[must_use]
    pub fn normalised(self, normalisation: &Normalisation) -> Self {
        let calibration = normalisation.calibration(self.calibration);
        Self { side: self.side / normalisation.scale, calibration, ..self }
    }

    /// Reads the record of the dataset in `folder`; `None` for a dataset from elsewhere, or a missing folder.
    ///
    /// # Errors
    /// A file that cannot be read or is not such a record.
    pub fn read(folder: &Path) -> Result<Option<Self>, RecordError> {
        let path = folder.join(FILE);
        let read = match read_text(&path) {
            Ok(text) => versioned::from_json(text)
                .map(Some)
                .map_err(|e| format!("{e}; make the dataset again with this version of `volseggs prepare`")),
            Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => Ok(None),
            Err(e) => Err(e.to_string()),
        };
        read.map_err(|e| RecordError { problem: plain(&e), path })
    }
}
