//! VTK XML image data with appended arrays, compressed with zlib block by block. What the arrays hold is decided by the
//! caller.

use crate::volume::grid::Grid;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use std::io::{self, Write as _};

/// Bytes in a block before compression.
const BLOCK: usize = 1 << 18;

/// A file under construction.
#[derive(Debug, Default)]
pub(super) struct VtiImage {
    field_data: String,
    point_data: String,
    values: Vec<u8>,
}

impl VtiImage {
    /// Adds an array about the file as a whole: `tuples` of `components` numbers, as text.
    pub(super) fn field(&mut self, kind: &str, name: &str, [tuples, components]: [usize; 2], text: &str) {
        let components = if components > 1 { format!(r#" NumberOfComponents="{components}""#) } else { String::new() };
        self.field_data += &format!(
            r#"      <DataArray type="{kind}" Name="{name}"{components} NumberOfTuples="{tuples}" format="ascii">{text}</DataArray>"#
        );
        self.field_data.push('\n');
    }

    /// Adds an array of texts about the file as a whole, as VTK writes strings in text: the number of each byte, and 0
    /// after each string.
    pub(super) fn texts<'t>(&mut self, name: &str, texts: impl ExactSizeIterator<Item = &'t str>) {
        let tuples = texts.len();
        let bytes = texts.flat_map(|text| text.bytes().chain([0]));
        self.field("String", name, [tuples, 1], &bytes.map(|b| b.to_string()).collect::<Vec<_>>().join(" "));
    }

    /// Adds an array with the values of every voxel as little-endian bytes; `components` is left out of the file where it
    /// is `None`.
    ///
    /// # Errors
    /// None that is known: the values are compressed in memory.
    pub(super) fn points(&mut self, kind: &str, name: &str, components: Option<usize>, bytes: &[u8]) -> io::Result<()> {
        let components = components.map_or_else(String::new, |n| format!(r#" NumberOfComponents="{n}""#));
        let offset = self.values.len();
        self.point_data += &format!(
            r#"        <DataArray type="{kind}" Name="{name}"{components} format="appended" offset="{offset}"/>"#
        );
        self.point_data.push('\n');
        append(&mut self.values, bytes)
    }

    /// The whole file; `active` are the attributes that name the active arrays.
    pub(super) fn finish(self, comment: &str, grid: &Grid, active: &str) -> Vec<u8> {
        let Self { field_data, point_data, values } = self;
        let [nx, ny, nz] = grid.dims.map(|d| d - 1);
        let ([sx, sy, sz], [ox, oy, oz]) = (grid.spacing, grid.origin);
        let extent = format!("0 {nx} 0 {ny} 0 {nz}");
        let direction = direction(grid);
        let mut file = format!(
            r#"<?xml version="1.0"?>
<!-- {comment} -->
<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64" compressor="vtkZLibDataCompressor">
  <ImageData WholeExtent="{extent}" Origin="{ox} {oy} {oz}" Spacing="{sx} {sy} {sz}"{direction}>
    <FieldData>
{field_data}    </FieldData>
    <Piece Extent="{extent}">
      <PointData{active}>
{point_data}      </PointData>
      <CellData/>
    </Piece>
  </ImageData>
  <AppendedData encoding="raw">
   _"#
        )
        .into_bytes();
        file.extend(values);
        file.extend_from_slice(b"\n  </AppendedData>\n</VTKFile>\n");
        file
    }
}

/// The attribute for the directions of a grid, row by row. Readers from before VTK 9 know none, so that it is written only
/// where it says something.
fn direction(grid: &Grid) -> String {
    if grid.directions.is_aligned() {
        return String::new();
    }
    let rows = grid.directions.matrix().transpose().to_cols_array();
    format!(r#" Direction="{}""#, rows.map(|v| v.to_string()).join(" "))
}

/// Compresses `bytes` after VTK's header: the number of blocks, the size of a block, that of the last if it is smaller,
/// and the compressed size of each.
fn append(file: &mut Vec<u8>, bytes: &[u8]) -> io::Result<()> {
    let blocks = bytes.len().div_ceil(BLOCK);
    for number in [blocks, BLOCK, bytes.len() % BLOCK] {
        file.extend_from_slice(&(number as u64).to_le_bytes());
    }
    let mut sizes = file.len();
    file.resize(sizes + 8 * blocks, 0);
    for block in bytes.chunks(BLOCK) {
        let start = file.len();
        let mut zlib = ZlibEncoder::new(&mut *file, Compression::default());
        zlib.write_all(block)?;
        zlib.finish()?;
        let packed = (file.len() - start) as u64;
        file[sizes..sizes + 8].copy_from_slice(&packed.to_le_bytes());
        sizes += 8;
    }
    Ok(())
}
