//! VTK XML image data: one appended array for each field, compressed with zlib block by block.

use super::{Field, FieldVolume};
use crate::export::labels::vti::{append, array, codes, document};
use std::fmt::Write as _;
use std::io;

/// Encodes the whole file.
pub fn encode(volume: &FieldVolume<'_>) -> io::Result<Vec<u8>> {
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
    let known = [
        array("Float64", r#"Name="TimeValue""#, 1, &volume.time.to_string()),
        array("String", r#"Name="time_unit""#, 1, &codes([volume.time_unit])),
        volume.unit.map_or_else(String::new, |unit| array("String", r#"Name="length_unit""#, 1, &codes([unit]))),
        array("String", r#"Name="field_names""#, n, &codes(names)),
        array("String", r#"Name="field_units""#, n, &codes(units)),
        array("UInt8", r#"Name="edited""#, 1, if volume.edited { "1" } else { "0" }),
    ];
    let active = active("Scalars", 1) + &active("Vectors", 3);
    Ok(document(&volume.grid, &volume.comment(), &known.concat(), &active, &arrays, &data))
}
