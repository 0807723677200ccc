//! Writers of label volumes: NRRD (with what 3D Slicer needs to show segments) and VTK image data.
//!
//! This module holds the volume to write, its checks and what its files say of it; the formats are in
//! `nrrd` and `vti`. Nothing here computes labels.

#[cfg(test)]
mod tests;

use super::nrrd::NrrdHeader;
use super::vti::VtiImage;
use crate::data::calibration::AxisConvention;
use crate::files::{MARK, ReplaceError, write_named};
use crate::volume::grid::Grid;
use flate2::Compression;
use std::path::{Path, PathBuf};

/// A label that occurs in a volume.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedLabel {
    /// Its value in the volume, not 0.
    pub value: u16,
    /// Its name, without control characters.
    pub name: String,
    /// Red, green, blue in `[0, 1]`, for viewers.
    pub colour: [f32; 3],
}

/// A volume of labels at one time.
#[derive(Clone, Copy, Debug)]
pub struct LabelVolume<'a> {
    /// Position of the voxels; `origin` is the centre of the first.
    pub grid: Grid,
    /// What the axes of space mean; `None` if that is unknown, so that files state nothing. VTK image data cannot.
    pub axes: Option<AxisConvention>,
    /// Unit of length, if it is known. VTK image data cannot state it.
    pub unit: Option<&'a str>,
    /// Labels `[z, y, x]`, x fastest; 0 is none.
    pub ids: &'a [u16],
    /// Every label that occurs, in the order in which viewers list them. Labels that do not occur may be listed too.
    pub names: &'a [NamedLabel],
    /// Whether these are labels of the scene with its edits; if not, they are of the scene as trained, which is the one
    /// aligned with the data. The file says which.
    pub edited: bool,
}

impl LabelVolume<'_> {
    /// Returns the comment of the file: which program wrote it, and what it holds.
    fn comment(&self) -> String {
        let state = if self.edited { "with the edits of the run" } else { "as trained, without edits" };
        format!("{MARK}: labels of segments of a scene {state}")
    }
}

/// Why a label volume cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum LabelsError {
    /// The number of labels is not the number of voxels.
    #[error("{}: ids: {found} labels for a grid of {dims:?} voxels; give one for each voxel", path.display())]
    Shape {
        /// The file to write.
        path: PathBuf,
        /// Labels given.
        found: usize,
        /// Voxels along x, y, z.
        dims: [usize; 3],
    },
    /// A name or the grid cannot be written.
    #[error("{}: {field}: {problem}", path.display())]
    Field {
        /// The file to write.
        path: PathBuf,
        /// The field, as in `names[2].colour`.
        field: String,
        /// What is wrong and how to fix it.
        problem: String,
    },
    /// A label has no name.
    #[error("{}: label {value} occurs in the volume but has no name; name it, or set its voxels to 0", path.display())]
    Unnamed {
        /// The file to write.
        path: PathBuf,
        /// The label.
        value: u16,
    },
    /// Something else is where the file should go.
    #[error(transparent)]
    Replace(#[from] ReplaceError),
    /// The file cannot be written.
    #[error("{}: cannot write the labels: {source}; check the folder and the free disk space", path.display())]
    Io {
        /// The file to write.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
}

/// Writes an NRRD file with an attached header and gzip data, 8-bit if the labels allow. If the file is called
/// `.seg.nrrd`, 3D Slicer opens it as a segmentation with names and colours; other readers find the names as
/// `label_1:=name`. Replaces only a file of this program.
///
/// # Errors
/// [`LabelsError`]; nothing is then written.
pub fn write_nrrd(path: &Path, volume: &LabelVolume<'_>) -> Result<(), LabelsError> {
    let occurring = check(path, volume)?;
    let LabelBytes { bytes, wide } = cells(volume);
    let header = NrrdHeader {
        comment: volume.comment(),
        kind: if wide { "uint16" } else { "uint8" },
        grid: &volume.grid,
        axes: volume.axes,
        unit: volume.unit,
        several: None,
        keys: nrrd_keys(volume, &occurring),
    };
    write(path, header.encode(Compression::default(), |values| values(&bytes)))
}

/// What an NRRD file says of the labels. The keys `Segment...` are those of 3D Slicer.
fn nrrd_keys(volume: &LabelVolume<'_>, extents: &[Extent]) -> Vec<(String, String)> {
    let mut keys = Vec::new();
    let mut key = |key: &str, value: &str| keys.push((key.to_owned(), value.to_owned()));
    key("Segmentation_ContainedRepresentationNames", "Binary labelmap|");
    // Slicer renamed Master to Source; old versions need the former, new ones read both
    key("Segmentation_MasterRepresentation", "Binary labelmap");
    key("Segmentation_SourceRepresentation", "Binary labelmap");
    key("Segmentation_ReferenceImageExtentOffset", "0 0 0");
    for (i, (label, extent)) in volume.names.iter().zip(extents).enumerate() {
        let [r, g, b] = label.colour;
        let extent = match extent {
            Some([x, y, z]) => format!("{} {} {} {} {} {}", x[0], x[1], y[0], y[1], z[0], z[1]),
            None => "0 -1 0 -1 0 -1".to_owned(),
        };
        for (name, value) in [
            ("ID", &*format!("Segment_{}", label.value)),
            ("Name", &label.name),
            ("NameAutoGenerated", "0"),
            ("Color", &format!("{r} {g} {b}")),
            ("ColorAutoGenerated", "0"),
            ("LabelValue", &label.value.to_string()),
            ("Layer", "0"),
            ("Extent", &extent),
            ("Tags", "|"),
        ] {
            key(&format!("Segment{i}_{name}"), value);
        }
    }
    key("edited", if volume.edited { "yes" } else { "no" });
    for label in volume.names {
        key(&format!("label_{}", label.value), &label.name);
    }
    keys
}

/// Writes VTK image data (`.vti`) with the point array `labels`, zlib-compressed, 8-bit if the labels allow. The field
/// arrays `label_values`, `label_names` and `label_colours` say what the values mean, `edited` is 1 or 0. Replaces only
/// a file of this program.
///
/// # Errors
/// [`LabelsError`]; nothing is then written.
pub fn write_vti(path: &Path, volume: &LabelVolume<'_>) -> Result<(), LabelsError> {
    check(path, volume)?;
    let LabelBytes { bytes, wide } = cells(volume);
    let n = volume.names.len();
    let values: Vec<String> = volume.names.iter().map(|l| l.value.to_string()).collect();
    let colours: Vec<String> = volume.names.iter().flat_map(|l| l.colour).map(|c| c.to_string()).collect();
    let mut image = VtiImage::default();
    image.field("UInt16", "label_values", [n, 1], &values.join(" "));
    image.texts("label_names", volume.names.iter().map(|l| l.name.as_str()));
    image.field("Float32", "label_colours", [n, 3], &colours.join(" "));
    image.field("UInt8", "edited", [1, 1], &u8::from(volume.edited).to_string());
    let encoded = image.points(if wide { "UInt16" } else { "UInt8" }, "labels", None, &bytes);
    write(path, encoded.map(|()| image.finish(&volume.comment(), &volume.grid, r#" Scalars="labels""#)))
}

fn write(path: &Path, encoded: std::io::Result<Vec<u8>>) -> Result<(), LabelsError> {
    let bytes = encoded.map_err(|source| LabelsError::Io { path: path.to_owned(), source })?;
    Ok(write_named(path, &bytes)?)
}

/// The labels as little-endian bytes.
struct LabelBytes {
    bytes: Vec<u8>,
    wide: bool,
}

fn cells(volume: &LabelVolume<'_>) -> LabelBytes {
    let wide = volume.names.iter().any(|n| n.value > 255);
    let ids = volume.ids.iter();
    let bytes = if wide { ids.flat_map(|v| v.to_le_bytes()).collect() } else { ids.map(|v| *v as u8).collect() };
    LabelBytes { bytes, wide }
}

/// First and last voxel along x, y, z of a label; `None` if it does not occur.
type Extent = Option<[[usize; 2]; 3]>;

/// Checks the volume and returns the extent of each named label.
fn check(path: &Path, volume: &LabelVolume<'_>) -> Result<Vec<Extent>, LabelsError> {
    let bad = |field: String, problem: String| Err(LabelsError::Field { path: path.to_owned(), field, problem });
    let Grid { dims, spacing, origin, .. } = volume.grid;
    let count = dims.iter().try_fold(1usize, |n, d| n.checked_mul(*d));
    if count != Some(volume.ids.len()) || volume.ids.is_empty() {
        return Err(LabelsError::Shape { path: path.to_owned(), found: volume.ids.len(), dims });
    }
    if !spacing.iter().all(|s| s.is_finite() && *s > 0.0) || !origin.iter().all(|o| o.is_finite()) {
        let problem = format!("spacing {spacing:?}, origin {origin:?}; give positive spacings and a finite origin");
        return bad("grid".to_owned(), problem);
    }
    let mut place = vec![usize::MAX; 1 << 16];
    for (i, label) in volume.names.iter().enumerate() {
        let field = |name: &str| format!("names[{i}].{name}");
        let before = std::mem::replace(&mut place[usize::from(label.value)], i);
        if label.value == 0 || before != usize::MAX {
            let problem = if label.value == 0 { "0 is not a label" } else { "is given twice" };
            return bad(field("value"), format!("{problem}; number the labels from 1, each once"));
        }
        if label.name.trim().is_empty() || label.name.chars().any(char::is_control) {
            return bad(field("name"), format!("{:?} is blank or has control characters; rename it", label.name));
        }
        if !label.colour.iter().all(|c| (0.0..=1.0).contains(c)) {
            return bad(field("colour"), format!("{:?} is not a colour; give numbers from 0 to 1", label.colour));
        }
    }
    extents(volume, &place).map_err(|value| LabelsError::Unnamed { path: path.to_owned(), value })
}

/// Returns the extents, ordered by the place of each label among the names, or a label without a place.
fn extents(volume: &LabelVolume<'_>, place: &[usize]) -> Result<Vec<Extent>, u16> {
    let mut extents: Vec<Extent> = vec![None; volume.names.len()];
    let [nx, ny, _] = volume.grid.dims;
    for (r, row) in volume.ids.chunks_exact(nx).enumerate() {
        let mut x = 0;
        for run in row.chunk_by(|a, b| a == b) {
            let ends = [[x, x + run.len() - 1], [r % ny; 2], [r / ny; 2]];
            x += run.len();
            if run[0] == 0 {
                continue;
            }
            let extent = extents.get_mut(place[usize::from(run[0])]).ok_or(run[0])?.get_or_insert(ends);
            for ([low, high], end) in extent.iter_mut().zip(ends) {
                (*low, *high) = ((*low).min(end[0]), (*high).max(end[1]));
            }
        }
    }
    Ok(extents)
}
