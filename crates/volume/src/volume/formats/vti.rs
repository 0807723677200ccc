//! VTK XML image data (`.vti`): serial files of one piece, in ascii, inline base64 or appended (raw or base64) form,
//! uncompressed or compressed with zlib or lz4. The markup is read in `xml`, the numbers in `data`.
//!
//! The `vtkio` crate is not used: version 0.7.0-rc2 rejects raw appended data (the form VTK writes by default),
//! silently drops arrays it cannot read, panics on damaged block headers and allocates whatever they ask for.

mod data;
#[cfg(test)]
mod tests;
mod xml;

use super::common;
use super::stream::read_error;
use crate::memory::MemoryBudget;
use crate::volume::error::VolumeError;
use crate::volume::grid::Grid;
use crate::volume::source::{PhysicalMetadata, VolumeFile, VolumeHeader, VolumeVariable};
use data::{ArrayLayout, Packing, VtiEncoding};
use glam::DVec3;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use xml::{Array, ArraySection, Image, VtiDocument};

/// Opens a `.vti` file and reads its markup; the values stay on disk. The array is the one called `variable`, or else
/// the active one, or else the first, of those with one component.
///
/// # Errors
/// An unreadable file, one that is not serial VTK image data of one piece, one without such an array, one that claims
/// more values than it can hold, or an unknown type or compressor.
pub fn open(path: &Path, variable: Option<&str>) -> Result<Box<dyn VolumeFile>, VolumeError> {
    let (file, file_len) = common::open_file(path)?;
    check_inline(path, file_len)?;
    let doc = xml::parse(path, BufReader::new(file))?;
    let mut notes = Vec::new();
    let (array, cells) = match variable {
        Some(name) => named(path, &doc, name)?,
        None => choose(path, &doc, &mut notes)?,
    };
    if cells {
        notes.push("values are on cells: the grid is one smaller, at the cell centres".to_owned());
    }
    let grid = grid(path, &doc, cells, &mut notes)?;
    let layout = layout(path, &doc, array, grid.dims, file_len)?;
    let header = VolumeHeader { grid, scalar: layout.kind, steps: 1, physical: PhysicalMetadata::default(), notes };
    let variable = array.name.clone();
    let of = |a: &Array| VolumeVariable { name: a.name.clone(), components: a.components };
    let variables = doc.point.arrays.iter().chain(&doc.cell.arrays).map(of).collect();
    Ok(Box::new(Vti { path: path.to_owned(), header, layout, variable, variables }))
}

/// Rejects a file whose values lie between its tags and do not fit into memory: the text of a tag is held whole.
/// Appended values are not.
fn check_inline(path: &Path, file_len: u64) -> Result<(), VolumeError> {
    const MARKUP: u64 = 1 << 20;
    let Err(error) = MemoryBudget::now().check("text between its tags", u128::from(file_len) * 3) else {
        return Ok(());
    };
    let mut start = Vec::new();
    let (file, _) = common::open_file(path)?;
    file.take(MARKUP).read_to_end(&mut start).map_err(|e| read_error(path, "markup", e))?;
    if start.windows(13).any(|w| w == b"<AppendedData") {
        return Ok(());
    }
    Err(VolumeError::invalid(path, "DataArray", error.to_string(), "or write the values as appended data"))
}

/// An open `.vti` file: what to read, and where.
#[derive(Debug)]
struct Vti {
    path: PathBuf,
    header: VolumeHeader,
    layout: ArrayLayout,
    variable: String,
    variables: Vec<VolumeVariable>,
}

impl VolumeFile for Vti {
    fn header(&self) -> &VolumeHeader {
        &self.header
    }

    fn variable(&self) -> Option<&str> {
        Some(&self.variable)
    }

    fn variables(&self) -> &[VolumeVariable] {
        &self.variables
    }

    fn read(&self, step: usize, out: &mut Vec<f32>) -> Result<(), VolumeError> {
        out.clear();
        if step != 0 {
            let problem = format!("no step {step}");
            return Err(VolumeError::invalid(&self.path, "step", problem, "the file has step 0 only"));
        }
        let (file, _) = common::open_file(&self.path)?;
        common::reserve(&self.path, out, self.layout.count)?;
        data::read(file, &self.layout, out).map_err(|e| read_error(&self.path, &field_name(&self.variable), e))
    }
}

fn field_name(variable: &str) -> String {
    format!("DataArray \"{variable}\"")
}

/// The array of this name, that on points before that on cells, and whether its values are on cells.
fn named<'a>(path: &Path, doc: &'a VtiDocument, name: &str) -> Result<(&'a Array, bool), VolumeError> {
    let find = |section: &'a ArraySection| section.arrays.iter().find(|a| a.name == name);
    let Some((array, cells)) = find(&doc.point).map(|a| (a, false)).or_else(|| find(&doc.cell).map(|a| (a, true)))
    else {
        let problem = format!("there is no array {name:?} among {}", listed(doc));
        let hint = "choose one that every file has with --variable NAME, or leave this file out";
        return Err(VolumeError::invalid(path, "PointData", problem, hint));
    };
    if array.components != 1 {
        let problem = format!("has {} components, but a field has one", array.components);
        let hint = "save one component or the magnitude as an array of its own, for example with ParaView's Calculator";
        return Err(VolumeError::invalid(path, field_name(name), problem, hint));
    }
    Ok((array, cells))
}

/// All arrays, for messages.
fn listed(doc: &VtiDocument) -> String {
    let all = doc.point.arrays.iter().chain(&doc.cell.arrays);
    let words = |a: &Array| match a.components {
        1 => a.name.clone(),
        n => format!("{} ({n} components)", a.name),
    };
    all.map(words).collect::<Vec<_>>().join(", ")
}

/// The array to read, and whether its values are on cells.
fn choose<'a>(path: &Path, doc: &'a VtiDocument, notes: &mut Vec<String>) -> Result<(&'a Array, bool), VolumeError> {
    if let Some(array) = choose_in(&doc.point, "PointData", notes) {
        return Ok((array, false));
    }
    if let Some(array) = choose_in(&doc.cell, "CellData", notes) {
        return Ok((array, true));
    }
    let hint = "write an array with one component into PointData";
    if doc.point.arrays.is_empty() && doc.cell.arrays.is_empty() {
        return Err(VolumeError::invalid(path, "PointData", "holds no DataArray", hint));
    }
    Err(VolumeError::invalid(path, "PointData", format!("no one-component array among {}", listed(doc)), hint))
}

/// The active one-component array of a section, else the first one, with notes on what was skipped.
fn choose_in<'a>(section: &'a ArraySection, place: &str, notes: &mut Vec<String>) -> Option<&'a Array> {
    // ghost flags mark voxels owned by another piece; they are never the field itself
    let scalars: Vec<_> = section.arrays.iter().filter(|a| a.components == 1 && a.name != "vtkGhostType").collect();
    if let Some(active) = &section.active {
        if let Some(array) = scalars.iter().find(|a| a.name == *active) {
            return Some(array);
        }
        if !scalars.is_empty() {
            notes.push(format!(
                "the active array \"{active}\" of {place} is missing or has several components: skipped"
            ));
        }
    }
    let (first, rest) = scalars.split_first()?;
    if !rest.is_empty() {
        let others: Vec<_> = rest.iter().map(|a| a.name.as_str()).collect();
        notes.push(format!(
            "read the first array \"{}\" of {place}; not read: {}; choose with --variable NAME",
            first.name,
            others.join(", ")
        ));
    }
    Some(first)
}

fn grid(path: &Path, doc: &VtiDocument, cells: bool, notes: &mut Vec<String>) -> Result<Grid, VolumeError> {
    let Image { extent: whole_extent, spacing: spacings, origin, direction: d } = doc.image;
    let extent = doc.piece_extent;
    if extent != whole_extent {
        notes.push("the piece covers part of WholeExtent: only that part is read".to_owned());
    }
    let steps = [0, 1, 2].map(|a| [0, 1, 2].map(|row| d[3 * row + a] * spacings[a]));
    let bad = |field: &str, problem: String, hint: &str| Err(VolumeError::invalid(path, field, problem, hint));
    let mut dims = [1; 3];
    // voxels from the image's origin to the first value
    let mut first = [0.0; 3];
    for a in 0..3 {
        let (lo, hi) = (i64::from(extent[2 * a]), i64::from(extent[2 * a + 1]));
        let points = usize::try_from(hi - lo + 1).unwrap_or(0);
        if points == 0 {
            let problem = format!("axis {a} runs from {lo} to {hi}: no voxels");
            return bad("Extent", problem, "write each axis as first and last index");
        }
        let spacing = spacings[a];
        if !(spacing.is_finite() && spacing > 0.0 && origin[a].is_finite()) {
            let problem = format!("axis {a}: spacing {spacing}, origin {}", origin[a]);
            return bad("Spacing", problem, "spacings must be finite and positive, origins finite");
        }
        (dims[a], first[a]) = (points, lo as f64);
        if cells && points > 1 {
            dims[a] = points - 1;
            first[a] += 0.5;
        }
    }
    common::check_spacing(path, "Spacing", spacings)?;
    let (directions, spacing) = common::directions(path, "Direction", steps)?;
    let grid = Grid { dims, spacing, origin, directions };
    let origin = grid.position(DVec3::from_array(first)).to_array();
    Ok(Grid { origin: common::check_origin(path, "Origin", origin)?, ..grid })
}

/// The location of the values, once the claimed size is known to fit the file.
fn layout(
    path: &Path,
    doc: &VtiDocument,
    array: &Array,
    dims: [usize; 3],
    file_len: u64,
) -> Result<ArrayLayout, VolumeError> {
    let field = field_name(&array.name);
    let bad = |problem: String, hint: &str| VolumeError::invalid(path, field.clone(), problem, hint);
    let kind = xml::kind(&array.kind)
        .ok_or_else(|| bad(format!("unknown type \"{}\"", array.kind), "use Int8 to UInt64, Float32 or Float64"))?;
    let (encoding, start, len) = match array.format.as_str() {
        "ascii" | "binary" => {
            let Some((start, len)) = array.text else {
                return Err(bad("holds no values".to_owned(), "write the file again"));
            };
            (if array.format == "ascii" { VtiEncoding::Ascii } else { VtiEncoding::Base64 }, start, len)
        }
        "appended" => {
            let Some((origin, raw)) = doc.appended else {
                let problem = "points into AppendedData, which the file lacks".to_owned();
                return Err(bad(problem, "the file is truncated: copy or write it again"));
            };
            let start = origin.checked_add(array.offset).filter(|s| *s < file_len).ok_or_else(|| {
                bad(format!("offset {} is past the end of the file", array.offset), "copy or write the file again")
            })?;
            (if raw { VtiEncoding::Raw } else { VtiEncoding::Base64 }, start, file_len - start)
        }
        other => return Err(bad(format!("unknown format \"{other}\""), "use ascii, binary or appended")),
    };
    let packing = match doc.compressor.as_str() {
        _ if encoding == VtiEncoding::Ascii => Packing::Plain,
        "" => Packing::Plain,
        "vtkZLibDataCompressor" => Packing::Zlib,
        "vtkLZ4DataCompressor" => Packing::Lz4,
        other => {
            let hint = "write the file with zlib, lz4 or no compression (SetCompressorTypeToZLib)";
            return Err(VolumeError::invalid(path, "compressor", format!("cannot unpack \"{other}\""), hint));
        }
    };
    // the most bytes that the available data can hold: zlib expands at most 1032:1, lz4 255:1
    let held = match (encoding, packing) {
        (VtiEncoding::Ascii, _) => len.div_ceil(2) * kind.bytes() as u64,
        (VtiEncoding::Base64, Packing::Plain) => len / 4 * 3,
        (_, Packing::Plain) => len,
        (_, Packing::Zlib) => len.saturating_mul(1032),
        (_, Packing::Lz4) => len.saturating_mul(255),
    };
    let count = dims.iter().try_fold(1usize, |n, d| n.checked_mul(*d));
    let needed = count.and_then(|n| n.checked_mul(kind.bytes())).filter(|n| *n as u64 <= held);
    let (Some(count), Some(_)) = (count, needed) else {
        let problem = format!("the extent claims {dims:?} values of {} bytes, more than the file holds", kind.bytes());
        return Err(bad(problem, "the file is truncated or its extent wrong: copy or write it again"));
    };
    Ok(ArrayLayout { start, len, encoding, packing, wide: doc.wide, endian: doc.endian, kind, count })
}
