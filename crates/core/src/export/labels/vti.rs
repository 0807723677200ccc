//! VTK XML image data: the labels as one appended array, compressed with zlib block by block.

use super::{Cells, LabelVolume};
use crate::volume::grid::Grid;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use std::io::{self, Write as _};

/// Bytes in a block before compression.
const BLOCK: usize = 1 << 18;

/// Encodes the whole file.
pub(super) fn encode(volume: &LabelVolume<'_>, cells: &Cells) -> io::Result<Vec<u8>> {
    let kind = if cells.wide { "UInt16" } else { "UInt8" };
    let n = volume.names.len();
    let values: Vec<String> = volume.names.iter().map(|l| l.value.to_string()).collect();
    let colours: Vec<String> = volume.names.iter().flat_map(|l| l.colour).map(|c| c.to_string()).collect();
    let known = [
        array("UInt16", r#"Name="label_values""#, n, &values.join(" ")),
        array("String", r#"Name="label_names""#, n, &codes(volume.names.iter().map(|l| l.name.as_str()))),
        array("Float32", r#"Name="label_colours" NumberOfComponents="3""#, n, &colours.join(" ")),
        array("UInt8", r#"Name="edited""#, 1, if volume.edited { "1" } else { "0" }),
    ];
    let arrays = format!("        <DataArray type=\"{kind}\" Name=\"labels\" format=\"appended\" offset=\"0\"/>\n");
    let mut data = Vec::new();
    append(&mut data, &cells.bytes)?;
    Ok(document(&volume.grid, &volume.comment(), &known.concat(), r#" Scalars="labels""#, &arrays, &data))
}

/// A line of an array that is written as text, with `attributes` besides its type and the number of its entries.
pub fn array(kind: &str, attributes: &str, entries: usize, text: &str) -> String {
    format!(
        "      <DataArray type=\"{kind}\" {attributes} NumberOfTuples=\"{entries}\" format=\"ascii\">{text}</DataArray>\n"
    )
}

/// Puts a file together: the lines of what is known of the whole, the attributes and lines of the arrays of points, and
/// their appended `data`.
pub fn document(grid: &Grid, comment: &str, known: &str, active: &str, arrays: &str, data: &[u8]) -> Vec<u8> {
    let [nx, ny, nz] = grid.dims.map(|d| d - 1);
    let ([sx, sy, sz], [ox, oy, oz]) = (grid.spacing, grid.origin);
    let (extent, direction) = (format!("0 {nx} 0 {ny} 0 {nz}"), direction(grid));
    let head = format!(
        r#"<?xml version="1.0"?>
<!-- {comment} -->
<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64" compressor="vtkZLibDataCompressor">
  <ImageData WholeExtent="{extent}" Origin="{ox} {oy} {oz}" Spacing="{sx} {sy} {sz}"{direction}>
    <FieldData>
{known}    </FieldData>
    <Piece Extent="{extent}">
      <PointData{active}>
{arrays}      </PointData>
      <CellData/>
    </Piece>
  </ImageData>
  <AppendedData encoding="raw">
   _"#
    );
    [head.as_bytes(), data, b"\n  </AppendedData>\n</VTKFile>\n"].concat()
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

/// Encodes texts as VTK writes strings in text: the number of each byte, and 0 after each of them.
pub fn codes<'t>(texts: impl IntoIterator<Item = &'t str>) -> String {
    let bytes = texts.into_iter().flat_map(|text| text.bytes().chain([0]));
    bytes.map(|b| b.to_string()).collect::<Vec<_>>().join(" ")
}

/// Compresses `bytes` after VTK's header: the number of blocks, the size of a block, that of the last if it is smaller,
/// and the compressed size of each.
pub fn append(file: &mut Vec<u8>, bytes: &[u8]) -> io::Result<()> {
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
