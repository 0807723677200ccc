//! NRRD: a text header, then the numbers compressed with gzip.

use super::FieldVolume;
use crate::export::labels::nrrd::place;
use flate2::Compression;
use flate2::write::GzEncoder;
use std::fmt::Write as _;
use std::io::{self, Write as _};

/// Encodes the whole file.
pub fn encode(volume: &FieldVolume<'_>) -> io::Result<Vec<u8>> {
    let mut file = header(volume).into_bytes();
    let mut gzip = GzEncoder::new(&mut file, Compression::fast());
    volume.together(|values| {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        gzip.write_all(&bytes)
    })?;
    gzip.finish()?;
    Ok(file)
}

fn header(volume: &FieldVolume<'_>) -> String {
    let components = volume.components();
    // a vector of space, or a list of numbers of any kind
    let first = match volume.fields {
        _ if components == 1 => None,
        [_] => Some("vector"),
        _ => Some("list"),
    };
    let of_first = |text: String| if first.is_some() { text } else { String::new() };
    let [nx, ny, nz] = volume.grid.dims;
    let mut text = format!(
        "NRRD0004\n\
         # {}\n\
         type: float\n\
         dimension: {}\n\
         sizes: {}{nx} {ny} {nz}\n\
         {}\
         kinds: {}domain domain domain\n\
         endian: little\n\
         encoding: gzip\n",
        volume.comment(),
        3 + usize::from(first.is_some()),
        of_first(format!("{components} ")),
        place(&volume.grid, volume.axes, volume.unit, &of_first("none ".to_owned())),
        first.map_or_else(String::new, |kind| format!("{kind} ")),
    );
    let units = volume.fields.iter().map(|field| format!("{} {}", field.name, field.unit)).collect::<Vec<_>>();
    let mut line = |text_of: std::fmt::Arguments<'_>| {
        // writing to a string cannot fail
        let _ = writeln!(text, "{text_of}");
    };
    for (key, value) in [
        ("channels", volume.channels().join(" ")),
        ("field_units", units.join("; ")),
        ("time", format!("{} {}", volume.time, volume.time_unit)),
        ("edited", if volume.edited { "yes" } else { "no" }.to_owned()),
    ] {
        let value: String = value.chars().filter(|c| !c.is_control()).collect();
        line(format_args!("{key}:={}", value.replace('\\', "\\\\")));
    }
    text.push('\n');
    text
}
