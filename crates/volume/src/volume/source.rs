//! The output of the reader of a file format: a header, and one step at a time as `f32`.

use super::error::VolumeError;
use super::grid::{Grid, ScalarType};
use crate::data::calibration::AxisConvention;
use serde::Serialize;
use std::ops::Range;

/// The unit of positions in files that say nothing of the distance between voxels.
pub const VOXELS: &str = "voxels";

/// What a file says of the physical space and time that its grid and steps are in.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PhysicalMetadata {
    /// Unit of length as the file names it, such as `mm`, or [`VOXELS`]; `None` where it names none.
    pub length_unit: Option<String>,
    /// What the axes of space mean; `None` where the file does not say.
    pub axes: Option<AxisConvention>,
    /// The time of the steps of a file of many; `None` where it is unknown.
    pub time: Option<TimeAxis>,
}

/// Times of evenly spaced steps.
#[derive(Clone, Debug, PartialEq)]
pub struct TimeAxis {
    /// Time of the first step, finite.
    pub start: f64,
    /// Time between steps, finite and above 0.
    pub step: f64,
    /// Unit of time as the file names it, such as `s`; `None` where it names none.
    pub unit: Option<String>,
}

/// The content of a volume file, known before its values are read.
#[derive(Clone, Debug, PartialEq)]
pub struct VolumeHeader {
    /// The grid of each step.
    pub grid: Grid,
    /// How values are stored.
    pub scalar: ScalarType,
    /// Number of time steps in the file, at least 1 (a 4D file has more).
    pub steps: usize,
    /// What the grid's positions and the steps are in.
    pub physical: PhysicalMetadata,
    /// What the user should know: "unknown field ignored", ...
    pub notes: Vec<String>,
}

/// An array of a file that may hold several.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct VolumeVariable {
    /// Its name.
    pub name: String,
    /// Number of values for each voxel: 1 for a scalar field, 3 for vectors.
    pub components: u64,
}

/// An open volume file.
pub trait VolumeFile: Send + Sync + std::fmt::Debug {
    /// Its header.
    fn header(&self) -> &VolumeHeader;

    /// Name of the array that is read; `None` for formats whose files hold one field.
    fn variable(&self) -> Option<&str> {
        None
    }

    /// All arrays of the file, in its order; none for formats whose files hold one field.
    fn variables(&self) -> &[VolumeVariable] {
        &[]
    }

    /// Reads step `step` (0-based, below `header().steps`) into `out`, which is cleared first: `[z, y, x]`, x fastest.
    /// Values are converted to `f32`; they may be NaN or infinite, which the caller checks.
    ///
    /// # Errors
    /// A truncated or damaged file.
    fn read(&self, step: usize, out: &mut Vec<f32>) -> Result<(), VolumeError>;

    /// Reads the steps of a range one after another, each as by [`VolumeFile::read`]. Readers that have to decompress
    /// all that precedes a step do so once for the whole range.
    ///
    /// # Errors
    /// As for [`VolumeFile::read`].
    fn read_range(&self, steps: Range<usize>, out: &mut Vec<f32>) -> Result<(), VolumeError> {
        let mut one = Vec::new();
        out.clear();
        for step in steps {
            self.read(step, &mut one)?;
            out.extend_from_slice(&one);
        }
        Ok(())
    }
}
