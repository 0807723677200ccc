//! The ground truth of a dataset's segments in space: one file for each of a few times, with the id and the opacity of
//! every cell of a grid around the scene. `prepare` makes the volumes; here they are written and read.

use std::path::Path;

use safetensors::tensor::{Dtype, TensorView};
use safetensors::{SafeTensorError, SafeTensors};
use serde::{Deserialize, Serialize};

use super::error::DataError;
use super::normalisation::Normalisation;
use super::truth::{FILE, Truth};
use crate::tensors::{self, TensorFileError};
use crate::versioned;

/// Name of the header entry with time and geometry.
const ENTRY: &str = "volseggs.truth-volume";
/// Number of steps in which opacities are stored.
const PARTS: f32 = 65_535.0;

/// Ids and opacity of a dataset's segments on a grid of cells at one time, scene units: those of the cameras and the
/// Gaussians, in which the volume is centred at the origin.
#[derive(Clone, Debug, PartialEq)]
pub struct TruthVolume {
    /// Time in [0, 1].
    pub time: f64,
    /// Number of cells along x, y, z.
    pub dims: [usize; 3],
    /// Size of a cell along x, y, z.
    pub spacing: [f64; 3],
    /// Centre of the first cell.
    pub origin: [f64; 3],
    /// `[z, y, x]`: the segment of the voxel nearest to the cell's centre, 0 for none.
    pub ids: Vec<u16>,
    /// `[z, y, x]`: opacity in [0, 1] of the cell's content over the length of a cell (the cube root of its volume), by
    /// the transfer function; stored in steps of 1/65535.
    pub opacity: Vec<f32>,
}

/// The header entry.
#[derive(Serialize, Deserialize)]
struct TruthVolumeHeader {
    time: f64,
    spacing: [f64; 3],
    origin: [f64; 3],
}

impl Truth {
    /// The times in [0, 1] that have a volume, ascending; empty if there is none.
    pub fn volume_times(&self) -> Vec<f64> {
        let mut times: Vec<f64> = self.file.volumes.iter().map(|v| v.time).collect();
        times.sort_by(f64::total_cmp);
        times
    }

    /// The volume of the time nearest to `time`, the earlier of two equally near, in the scene.
    ///
    /// # Errors
    /// If the dataset has none, or its file is missing, damaged or invalid.
    pub fn volume(&self, time: f64) -> Result<TruthVolume, DataError> {
        let away = |t: f64| (t - time).abs();
        let nearest = self.file.volumes.iter().min_by(|a, b| {
            let order = away(a.time).total_cmp(&away(b.time));
            order.then(a.time.total_cmp(&b.time))
        });
        let Some(entry) = nearest else {
            let problem = "no volume of segment ids; the dataset was made without segment views";
            return Err(DataError::field_error(&self.root.join(FILE), None, "volumes", problem, AGAIN));
        };
        let volume = TruthVolume::read(&self.root.join(entry.file.strip_prefix("./").unwrap_or(&entry.file)))?;
        let Normalisation { scale, .. } = self.normalisation;
        let origin = self.normalisation.to_scene(volume.origin.into()).to_array();
        Ok(TruthVolume { origin, spacing: volume.spacing.map(|s| s / scale), ..volume })
    }
}

const AGAIN: &str = "make the dataset again with `volseggs prepare`";

impl TruthVolume {
    /// Centre of the cell `index` (x, y, z), scene units.
    pub fn centre(&self, index: [usize; 3]) -> [f64; 3] {
        std::array::from_fn(|a| self.origin[a] + self.spacing[a] * index[a] as f64)
    }

    /// Writes the volume: tensors `ids` and `opacity` of 16 bits `[z, y, x]`, the geometry in the header, and a digest
    /// of everything. The same volume gives the same bytes.
    ///
    /// # Errors
    /// If the file cannot be written, or `ids` and `opacity` do not fit `dims`.
    pub fn write(&self, path: &Path) -> Result<(), TensorFileError> {
        let wrong =
            |e: SafeTensorError| TensorFileError::Io { path: path.to_owned(), source: std::io::Error::other(e) };
        let [x, y, z] = self.dims;
        let bytes = |values: &mut dyn Iterator<Item = u16>| -> Vec<u8> { values.flat_map(u16::to_le_bytes).collect() };
        let ids = bytes(&mut self.ids.iter().copied());
        // NaN becomes 0, as a cast does
        let opacity = bytes(&mut self.opacity.iter().map(|o| (o.clamp(0.0, 1.0) * PARTS).round() as u16));
        let view = |data| TensorView::new(Dtype::U16, vec![z, y, x], data).map_err(wrong);
        let header = TruthVolumeHeader { time: self.time, spacing: self.spacing, origin: self.origin };
        let text =
            versioned::to_json(&header).map_err(|e| TensorFileError::Io { path: path.to_owned(), source: e.into() })?;
        tensors::write(path, vec![("ids", view(&ids)?), ("opacity", view(&opacity)?)], Some((ENTRY, text)))
    }

    /// Whether a file's header says that [`Self::write`] wrote it; it may be damaged even so.
    pub fn is_one(path: &Path) -> bool {
        tensors::header_entry(path, ENTRY).is_some()
    }

    /// Reads a volume that [`Self::write`] wrote.
    ///
    /// # Errors
    /// If the file is missing, damaged or invalid.
    pub fn read(path: &Path) -> Result<Self, DataError> {
        let fail = |field: &str, problem: String| DataError::field_error(path, None, field, problem, AGAIN);
        let bytes = tensors::read(path).map_err(|e| match e {
            TensorFileError::Io { path, source } => {
                DataError::Io { path, action: "read the volume of segment ids", source, hint: AGAIN.to_owned() }
            }
            TensorFileError::Damaged { reason, .. } => fail("tensors", format!("the file is damaged: {reason}")),
        })?;
        let broken = |e: SafeTensorError| fail("tensors", e.to_string());
        let (_, metadata) = SafeTensors::read_metadata(&bytes).map_err(broken)?;
        let text = metadata.metadata().as_ref().and_then(|m| m.get(ENTRY));
        let text = text.ok_or_else(|| fail(ENTRY, "is not in the header; not a volume of segment ids".to_owned()))?;
        let TruthVolumeHeader { time, spacing, origin } =
            versioned::from_json(text).map_err(|e| fail(ENTRY, e.to_string()))?;
        if !(time.is_finite() && origin.iter().all(|o| o.is_finite())) {
            return Err(fail(ENTRY, format!("time {time} and origin {origin:?} must be finite")));
        }
        if !spacing.iter().all(|s| s.is_finite() && *s > 0.0) {
            return Err(fail(ENTRY, format!("spacing {spacing:?} must be positive")));
        }
        let file = SafeTensors::deserialize(&bytes).map_err(broken)?;
        let tensor = |name: &str| -> Result<([usize; 3], Vec<u16>), DataError> {
            let view = file.tensor(name).map_err(|e| fail(name, e.to_string()))?;
            match (view.dtype(), view.shape()) {
                (Dtype::U16, &[z, y, x]) if x > 0 && y > 0 && z > 0 => {
                    let values = view.data().chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]]));
                    Ok(([x, y, z], values.collect()))
                }
                (dtype, shape) => Err(fail(name, format!("is {dtype:?} {shape:?}; expected U16 [z, y, x]"))),
            }
        };
        let ((dims, ids), (others, opacity)) = (tensor("ids")?, tensor("opacity")?);
        if dims != others {
            return Err(fail("opacity", format!("has {others:?} cells, ids have {dims:?}")));
        }
        let opacity = opacity.into_iter().map(|o| f32::from(o) / PARTS).collect();
        Ok(Self { time, dims, spacing, origin, ids, opacity })
    }
}

#[cfg(test)]
#[path = "truth_volume_tests.rs"]
mod tests;
