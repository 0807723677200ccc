//! Writers of fields on a voxel grid: VTK image data, NRRD and NumPy. Nothing here computes fields.

use super::npy::NpyWriter;
use super::nrrd::NrrdHeader;
use super::vti::VtiImage;
use crate::data::calibration::AxisConvention;
use crate::files::{MARK, ReplaceError, write_named};
use crate::volume::grid::Grid;
use flate2::Compression;
use std::path::Path;

/// A field on the voxels of a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct VoxelField {
    /// Its name, of lower-case letters.
    pub name: &'static str,
    /// Its unit, without control characters.
    pub unit: String,
    /// C, the numbers per voxel.
    pub components: usize,
    /// `[z, y, x, C]`, x fastest of the axes.
    pub values: Vec<f32>,
}

/// Fields at one time.
#[derive(Clone, Copy, Debug)]
pub struct FieldVolume<'a> {
    /// Position of the voxels; `origin` is the centre of the first.
    pub grid: Grid,
    /// What the axes of space mean; `None` if that is unknown, so that files state nothing. VTK image data cannot.
    pub axes: Option<AxisConvention>,
    /// The fields, at least one; each has `grid.len()` times its components values.
    pub fields: &'a [VoxelField],
    /// Unit of length, if it is known.
    pub unit: Option<&'a str>,
    /// The time.
    pub time: f64,
    /// Its unit.
    pub time_unit: &'a str,
    /// Whether these are fields of the scene with its edits; if not, of the scene as trained.
    pub edited: bool,
}

impl FieldVolume<'_> {
    /// Returns the comment of the file: which program wrote it, and what it holds.
    fn comment(&self) -> String {
        let state = if self.edited { "with the edits of the run" } else { "as trained, without edits" };
        format!("{MARK}: fields of the Gaussians of a scene {state}")
    }

    /// Returns numbers per voxel in all fields.
    fn components(&self) -> usize {
        self.fields.iter().map(|field| field.components).sum()
    }

    /// Returns the name of each number of a voxel, in the order of the file.
    pub fn channels(&self) -> Vec<String> {
        let of = |field: &VoxelField| -> Vec<String> {
            match (field.name, field.components) {
                (name, 1) => vec![name.to_owned()],
                ("colour", _) => ["red", "green", "blue"].map(str::to_owned).to_vec(),
                (name, n) => ["x", "y", "z"].iter().take(n).map(|axis| format!("{name}_{axis}")).collect(),
            }
        };
        self.fields.iter().flat_map(of).collect()
    }

    /// Calls `each` with the numbers of all fields, voxel by voxel, in pieces of whole rows.
    fn together<E>(&self, mut each: impl FnMut(&[f32]) -> Result<(), E>) -> Result<(), E> {
        let nx = self.grid.dims[0];
        let mut row = Vec::with_capacity(nx * self.components());
        for first in (0..self.grid.len()).step_by(nx) {
            row.clear();
            for voxel in first..first + nx {
                for field in self.fields {
                    row.extend_from_slice(&field.values[voxel * field.components..][..field.components]);
                }
            }
            each(&row)?;
        }
        Ok(())
    }
}

/// Writes VTK image data (`.vti`) with a point array for each field, zlib-compressed. The field arrays hold the time
/// (`TimeValue`, `time_unit`), the units (`field_names`, `field_units` and, if it is known, `length_unit`) and whether
/// edits are applied (`edited`, 1 or 0). Replaces only a file of this program.
///
/// # Errors
/// If something else is there, or it cannot be written.
pub fn write_vti(path: &Path, volume: &FieldVolume<'_>) -> Result<(), ReplaceError> {
    write(path, vti(volume))
}

fn vti(volume: &FieldVolume<'_>) -> std::io::Result<Vec<u8>> {
    let mut image = VtiImage::default();
    image.field("Float64", "TimeValue", [1, 1], &volume.time.to_string());
    image.texts("time_unit", [volume.time_unit].into_iter());
    if let Some(unit) = volume.unit {
        image.texts("length_unit", [unit].into_iter());
    }
    image.texts("field_names", volume.fields.iter().map(|field| field.name));
    image.texts("field_units", volume.fields.iter().map(|field| field.unit.as_str()));
    image.field("UInt8", "edited", [1, 1], &u8::from(volume.edited).to_string());
    for VoxelField { name, components, values, .. } in volume.fields {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        image.points("Float32", name, Some(*components), &bytes)?;
    }
    let active = |kind: &str, components: usize| {
        let field = volume.fields.iter().find(|field| field.components == components);
        field.map_or_else(String::new, |field| format!(r#" {kind}="{}""#, field.name))
    };
    Ok(image.finish(&volume.comment(), &volume.grid, &(active("Scalars", 1) + &active("Vectors", 3))))
}

/// Writes an NRRD file with gzip data: one scalar field has three axes, anything else a first axis for the numbers of a
/// voxel. Keys name these and their units. Replaces only a file of this program.
///
/// # Errors
/// As [`write_vti`].
pub fn write_nrrd(path: &Path, volume: &FieldVolume<'_>) -> Result<(), ReplaceError> {
    let components = volume.components();
    // a vector of space, or a list of numbers of any kind
    let axis = if volume.fields.len() == 1 { "vector" } else { "list" };
    let units = volume.fields.iter().map(|field| format!("{} {}", field.name, field.unit)).collect::<Vec<_>>();
    let keys = [
        ("channels", volume.channels().join(" ")),
        ("field_units", units.join("; ")),
        ("time", format!("{} {}", volume.time, volume.time_unit)),
        ("edited", if volume.edited { "yes" } else { "no" }.to_owned()),
    ];
    let header = NrrdHeader {
        comment: volume.comment(),
        kind: "float",
        grid: &volume.grid,
        axes: volume.axes,
        unit: volume.unit,
        several: (components != 1).then_some((components, axis)),
        keys: keys.map(|(key, value)| (key.to_owned(), value)).to_vec(),
    };
    let encoded = header.encode(Compression::fast(), |write| {
        volume.together(|values| write(&values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>()))
    });
    write(path, encoded)
}

/// Writes a NumPy array: `[z, y, x]` for one scalar field, else `[z, y, x, C]` with the numbers of all fields. It holds
/// neither units nor the place of the voxels. Replaces only a file of this program.
///
/// # Errors
/// As [`write_vti`].
pub fn write_npy(path: &Path, volume: &FieldVolume<'_>) -> Result<(), ReplaceError> {
    let ([x, y, z], components) = (volume.grid.dims, volume.components());
    let shape = [z, y, x, components];
    let mut array = NpyWriter::create(path, if components == 1 { &shape[..3] } else { &shape })?;
    volume.together(|values| array.add(values))?;
    array.finish()
}

fn write(path: &Path, encoded: std::io::Result<Vec<u8>>) -> Result<(), ReplaceError> {
    let bytes = encoded.map_err(|source| ReplaceError::Io { path: path.to_owned(), source })?;
    write_named(path, &bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::series::{Series, SeriesOptions};
    use std::path::PathBuf;
    use std::process::Command;
    use volseggs_testing::{Need, python_with};

    fn example() -> (Grid, Vec<VoxelField>) {
        let grid = Grid { spacing: [0.5, 1.0, 2.0], origin: [10.0, -1.0, 0.25], ..Grid::unit([4, 3, 2]) };
        let field = |name, components: usize, unit: &str| {
            let values = (0..24 * components).map(|i| i as f32 + 0.5 * components as f32).collect();
            VoxelField { name, unit: unit.into(), components, values }
        };
        (grid, vec![field("density", 1, "1/(mm)"), field("velocity", 3, "(mm)/(s)"), field("colour", 3, "1")])
    }

    fn write_all(folder: &Path, fields: &[VoxelField]) -> [PathBuf; 3] {
        let (grid, _) = example();
        let axes = Some(AxisConvention::LeftPosteriorSuperior);
        let volume = FieldVolume { grid, axes, fields, unit: Some("mm"), time: 2.5, time_unit: "s", edited: false };
        let paths = ["f.vti", "f.nrrd", "f.npy"].map(|name| folder.join(name));
        // twice, as a file of this program may be replaced
        for _ in 0..2 {
            write_vti(&paths[0], &volume).unwrap();
            write_nrrd(&paths[1], &volume).unwrap();
            write_npy(&paths[2], &volume).unwrap();
        }
        paths
    }

    #[test]
    fn our_own_readers_read_a_scalar_field_where_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let (grid, fields) = example();
        for path in write_all(folder.path(), &fields[..1]) {
            let series = Series::open(&[path.display().to_string()], &SeriesOptions::default()).unwrap();
            assert_eq!(series.load(0).unwrap().values, fields[0].values, "{}", path.display());
            if path.extension().is_some_and(|e| e != "npy") {
                assert_eq!(*series.grid(), grid, "{}", path.display());
            }
        }
        std::fs::write(folder.path().join("f.vti"), "a thesis").unwrap();
        let volume = FieldVolume {
            grid,
            axes: None,
            fields: &fields,
            unit: Some("mm"),
            time: 0.0,
            time_unit: "s",
            edited: true,
        };
        assert!(write_vti(&folder.path().join("f.vti"), &volume).is_err());
        assert_eq!(volume.channels(), ["density", "velocity_x", "velocity_y", "velocity_z", "red", "green", "blue"]);
    }

    #[test]
    fn vtk_pynrrd_and_numpy_read_all_fields() {
        let script = r#"
import sys, json, numpy, vtk, nrrd
from vtk.util.numpy_support import vtk_to_numpy
reader = vtk.vtkXMLImageDataReader(); reader.SetFileName(sys.argv[1]); reader.Update()
image = reader.GetOutput(); points, fields = image.GetPointData(), image.GetFieldData()
arrays = [vtk_to_numpy(points.GetArray(name)).reshape(24, -1) for name in ("density", "velocity", "colour")]
vti = numpy.concatenate(arrays, axis=1)
data, header = nrrd.read(sys.argv[2])
array = numpy.load(sys.argv[3])
assert data.shape == (7, 4, 3, 2) and array.shape == (2, 3, 4, 7), (data.shape, array.shape)
assert (data.transpose(3, 2, 1, 0).reshape(24, 7) == vti).all() and (array.reshape(24, 7) == vti).all()
units = [fields.GetAbstractArray("field_units").GetValue(i) for i in range(3)]
print(json.dumps([vti[5].tolist(), image.GetSpacing(), image.GetOrigin(), fields.GetArray("TimeValue").GetTuple1(0), units,
    points.GetVectors().GetName(), points.GetScalars().GetName(), header["space units"], header["channels"],
    numpy.array(header["space directions"]).tolist()[1:], header["time"], header["field_units"]]))
"#;
        let Some(python) = python_with("vtk, numpy, nrrd", Need::Vtk) else { return };
        let folder = tempfile::tempdir().unwrap();
        let output =
            Command::new(python).args(["-c", script]).args(write_all(folder.path(), &example().1)).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let read: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let expected = serde_json::json!([
            [5.5, 16.5, 17.5, 18.5, 16.5, 17.5, 18.5],
            [0.5, 1.0, 2.0],
            [10.0, -1.0, 0.25],
            2.5,
            ["1/(mm)", "(mm)/(s)", "1"],
            "velocity",
            "density",
            ["mm", "mm", "mm"],
            "density velocity_x velocity_y velocity_z red green blue",
            [[0.5, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0]],
            "2.5 s",
            "density 1/(mm); velocity (mm)/(s); colour 1"
        ]);
        assert_eq!(read, expected);
    }
}
