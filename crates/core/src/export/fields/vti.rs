//! VTK XML image data: one appended array for each field, compressed with zlib block by block.

use super::{Field, FieldVolume};
use crate::export::labels::vti::{append, codes, direction};
use std::fmt::Write as _;
use std::io;

/// Encodes the whole file.
pub fn encode(volume: &FieldVolume<'_>) -> io::Result<Vec<u8>> {
    let [nx, ny, nz] = volume.grid.dims.map(|d| d - 1);
    let ([sx, sy, sz], [ox, oy, oz]) = (volume.grid.spacing, volume.grid.origin);
    let direction = direction(&volume.grid);
    let extent = format!("0 {nx} 0 {ny} 0 {nz}");
    let (mut arrays, mut data) = (String::new(), Vec::new());
    for Field { name, components, values, .. } in volume.fields {
        // writing to a string cannot fail
        let _ = writeln!(
            arrays,
            r#"        <DataArray type="Float32" Name="{name}" NumberOfComponents="{components}" format="appended" offset="{}"/>"#,
            data.len()
        );
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        append(&mut data, &bytes)?;
    }
    let active = |kind: &str, components: usize| {
        let field = volume.fields.iter().find(|field| field.components == components);
        field.map_or_else(String::new, |field| format!(r#" {kind}="{}""#, field.name))
    };
    let (names, units) = (volume.fields.iter().map(|f| f.name), volume.fields.iter().map(|f| f.unit.as_str()));
    let n = volume.fields.len();
    let length = volume.unit.map_or_else(String::new, |unit| {
        let array = r#"      <DataArray type="String" Name="length_unit" NumberOfTuples="1" format="ascii">"#;
        format!("{array}{}</DataArray>\n", codes([unit]))
    });
    let mut file = format!(
        r#"<?xml version="1.0"?>
<!-- {} -->
<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64" compressor="vtkZLibDataCompressor">
  <ImageData WholeExtent="{extent}" Origin="{ox} {oy} {oz}" Spacing="{sx} {sy} {sz}"{direction}>
    <FieldData>
      <DataArray type="Float64" Name="TimeValue" NumberOfTuples="1" format="ascii">{}</DataArray>
      <DataArray type="String" Name="time_unit" NumberOfTuples="1" format="ascii">{}</DataArray>
{length}      <DataArray type="String" Name="field_names" NumberOfTuples="{n}" format="ascii">{}</DataArray>
      <DataArray type="String" Name="field_units" NumberOfTuples="{n}" format="ascii">{}</DataArray>
      <DataArray type="UInt8" Name="edited" NumberOfTuples="1" format="ascii">{}</DataArray>
    </FieldData>
    <Piece Extent="{extent}">
      <PointData{}{}>
{arrays}      </PointData>
      <CellData/>
    </Piece>
  </ImageData>
  <AppendedData encoding="raw">
   _"#,
        volume.comment(),
        volume.time,
        codes([volume.time_unit]),
        codes(names),
        codes(units),
        u8::from(volume.edited),
        active("Scalars", 1),
        active("Vectors", 3),
    )
    .into_bytes();
    file.extend(data);
    file.extend_from_slice(b"\n  </AppendedData>\n</VTKFile>\n");
    Ok(file)
}
