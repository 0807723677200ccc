//! NRRD files with an attached header and values compressed with gzip. What the values are is decided by the caller.

use crate::data::calibration::AxisConvention;
use crate::volume::grid::Grid;
use flate2::Compression;
use flate2::write::GzEncoder;
use glam::DVec3;
use std::io::{self, Write as _};

/// What a file says before its values.
pub(super) struct NrrdHeader<'a> {
    pub comment: String,
    /// The type of a value, such as `uint8`.
    pub kind: &'static str,
    pub grid: &'a Grid,
    /// What the axes of space mean, if that is known.
    pub axes: Option<AxisConvention>,
    /// The unit of length, if it is known.
    pub unit: Option<&'a str>,
    /// Where voxels have several values: their number and the kind of that first axis.
    pub several: Option<(usize, &'static str)>,
    /// Keys and their values; control characters are left out.
    pub keys: Vec<(String, String)>,
}

impl NrrdHeader<'_> {
    /// The whole file with these values, pieces of little-endian bytes.
    ///
    /// # Errors
    /// Those of the pieces.
    pub(super) fn encode(
        &self,
        compression: Compression,
        values: impl FnOnce(&mut dyn FnMut(&[u8]) -> io::Result<()>) -> io::Result<()>,
    ) -> io::Result<Vec<u8>> {
        let mut file = self.text().into_bytes();
        let mut gzip = GzEncoder::new(&mut file, compression);
        values(&mut |piece| gzip.write_all(piece))?;
        gzip.finish()?;
        Ok(file)
    }

    fn text(&self) -> String {
        let [nx, ny, nz] = self.grid.dims;
        let (dimension, size, none, axis) = match self.several {
            None => (3, String::new(), "", String::new()),
            Some((number, axis)) => (4, format!("{number} "), "none ", format!("{axis} ")),
        };
        let mut text = format!(
            "NRRD0004\n\
             # {}\n\
             type: {}\n\
             dimension: {dimension}\n\
             sizes: {size}{nx} {ny} {nz}\n\
             {}\
             kinds: {axis}domain domain domain\n\
             endian: little\n\
             encoding: gzip\n",
            self.comment,
            self.kind,
            self.place(none),
        );
        for (key, value) in &self.keys {
            let value: String = value.chars().filter(|c| !c.is_control()).collect();
            text += &format!("{key}:={}\n", value.replace('\\', "\\\\"));
        }
        text + "\n"
    }

    /// The lines that place the grid, with `first` before its directions: the space, the directions, the origin.
    fn place(&self, first: &str) -> String {
        let mut lines = match self.axes {
            Some(axes) => format!("space: {axes}\n"),
            None => "space dimension: 3\n".to_owned(),
        };
        if let Some(unit) = self.unit {
            let unit: String = unit.chars().filter(|c| !c.is_control() && *c != '"' && *c != '\\').collect();
            lines += &format!("space units: \"{unit}\" \"{unit}\" \"{unit}\"\n");
        }
        let vector = |v: DVec3| format!("({},{},{})", v.x, v.y, v.z);
        let steps = self.grid.steps();
        let [dx, dy, dz] = [steps.x_axis, steps.y_axis, steps.z_axis].map(vector);
        let origin = vector(DVec3::from_array(self.grid.origin));
        lines + &format!("space directions: {first}{dx} {dy} {dz}\nspace origin: {origin}\n")
    }
}
