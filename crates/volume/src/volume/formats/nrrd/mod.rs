//! NRRD files, attached (`.nrrd`) and detached (`.nhdr`), NRRD0001 to NRRD0005: turns fields into a header and its
//! data.

mod axes;
mod data;
mod place;
#[cfg(test)]
mod tests;
mod text;

use super::common::{self, VolumeShape};
use super::decode::Endian;
use crate::files::leads_out;
use crate::volume::error::VolumeError;
use crate::volume::grid::Grid;
use crate::volume::source::{VolumeFile, VolumeHeader};
use axes::NrrdAxes;
use data::{NrrdData, NrrdEncoding, ValueSelection};
use place::NrrdPlacement;
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};
use text::NrrdText;

/// Maximum length of a header, even of one that lists thousands of data files.
const MAX_HEADER: u64 = 1 << 22;

/// Maximum number of bytes decompressed to read all steps of one compressed file: some hours.
const MAX_UNPACKED: f64 = 1e13;

#[derive(Debug)]
struct Nrrd {
    path: PathBuf,
    header: VolumeHeader,
    shape: VolumeShape,
    time_first: bool,
    data: NrrdData,
}

/// Opens an NRRD file: reads its header and checks the sizes of its data files.
///
/// # Errors
/// A field that is missing, malformed or not supported, missing data files, or data that cannot hold the sizes.
pub fn open(path: &Path) -> Result<Box<dyn VolumeFile>, VolumeError> {
    let bad = |field: &str, problem: String, hint: &str| VolumeError::invalid(path, field, problem, hint);
    let (file, _) = common::open_file(path)?;
    let mut bytes = Vec::new();
    let fail = |e| VolumeError::io(path, "read the header", e, "check the disk");
    let mut reader = file.take(MAX_HEADER);
    // headers are short: the whole limit is read only if no blank line appears before
    while !bytes.windows(2).any(|w| w == b"\n\n") && !bytes.windows(4).any(|w| w == b"\r\n\r\n") {
        let more = (bytes.len() as u64).max(1 << 14);
        if reader.by_ref().take(more).read_to_end(&mut bytes).map_err(fail)? == 0 {
            break;
        }
    }
    let text = NrrdText::parse(path, &bytes)?;
    if text.end.is_none() && bytes.len() as u64 == MAX_HEADER {
        let problem = format!("does not end within {MAX_HEADER} bytes");
        return Err(bad("header", problem, "end it with a blank line"));
    }
    let axes = NrrdAxes::read(path, &text)?;

    let name = text.need(path, "type")?;
    let scalar = common::scalar_from_name(name).ok_or_else(|| {
        let hint = "save it as uchar, short, ushort, int, uint, longlong, ulonglong, float or double";
        bad("type", format!("\"{name}\" is not supported"), hint)
    })?;
    let encoding = match text.need(path, "encoding")?.to_ascii_lowercase().as_str() {
        "raw" => NrrdEncoding::Raw,
        "gz" | "gzip" => NrrdEncoding::Gzip,
        "txt" | "text" | "ascii" => NrrdEncoding::Ascii,
        other => return Err(bad("encoding", format!("\"{other}\" is not supported"), "save it as raw, gzip or ascii")),
    };
    let endian = match text.get("endian").map(str::to_ascii_lowercase).as_deref() {
        Some("little") => Endian::Little,
        Some("big") => Endian::Big,
        None if scalar.bytes() == 1 || encoding == NrrdEncoding::Ascii => Endian::Little,
        None => return Err(bad("endian", "is not given".into(), "add \"endian: little\" or \"endian: big\"")),
        Some(other) => return Err(bad("endian", format!("\"{other}\" is not a byte order"), "use little or big")),
    };
    let line_skip = match text.get("lineskip").map(str::parse).transpose() {
        Ok(n) => n.unwrap_or(0),
        Err(_) => return Err(bad("line skip", "is not a whole number".into(), "give the number of lines to skip")),
    };
    let byte_skip = match text.get("byteskip").map(str::parse::<i64>).transpose() {
        Ok(None) => Some(0),
        Ok(Some(-1)) if encoding == NrrdEncoding::Raw => None,
        Ok(Some(n)) if n >= 0 => Some(n as u64),
        _ => {
            return Err(bad("byte skip", "is not a number of bytes".into(), "give 0 or more, or -1 with raw encoding"));
        }
    };

    let shape = VolumeShape::new(path, "sizes", axes.dims, axes.steps, scalar)?;
    let values = shape.total_bytes / scalar.bytes() as u64;
    let (files, base) = if text.files.is_empty() {
        let hint = "end the header with a blank line before the data, or name a \"data file\"";
        let end = text.end.ok_or_else(|| bad("header", "has neither data nor a data file".into(), hint))?;
        (vec![path.to_owned()], end)
    } else {
        (text.files.iter().map(|f| path.with_file_name("").join(f)).collect(), 0)
    };
    let count = files.len() as u64;
    if !values.is_multiple_of(count) {
        let problem = format!("{values} values cannot be divided evenly among {count} files");
        return Err(bad("data file", problem, "name one file per entry of the last axis"));
    }
    let data = NrrdData { files, base, encoding, scalar, endian, line_skip, byte_skip, per_file: values / count };
    data.check(path)?;
    if axes.first == 1 && encoding == NrrdEncoding::Gzip && shape.total_bytes as f64 * shape.steps as f64 > MAX_UNPACKED
    {
        let problem =
            format!("time is the fastest axis, so each of the {} steps decompresses the whole file", shape.steps);
        return Err(bad("encoding", problem, "save it as raw, or with time as the last axis"));
    }

    let place = NrrdPlacement::read(path, &text, &axes)?;
    let grid = Grid { dims: shape.dims, ..place.grid };
    let outside = text.files.iter().find(|file| leads_out(Path::new(file)));
    let outside = outside.map(|file| format!("the data file {file} is not in the folder of its header"));
    let notes = text.notes.into_iter().chain(axes.notes).chain(place.notes).chain(outside).collect();
    let header = VolumeHeader { grid, scalar, steps: shape.steps, physical: place.physical, notes };
    Ok(Box::new(Nrrd { path: path.to_owned(), header, shape, time_first: axes.first == 1, data }))
}

impl VolumeFile for Nrrd {
    fn header(&self) -> &VolumeHeader {
        &self.header
    }

    fn read(&self, step: usize, out: &mut Vec<f32>) -> Result<(), VolumeError> {
        common::check_step(&self.path, step, self.shape.steps)?;
        common::prepare(&self.path, out, self.shape.voxels)?;
        let (step, count) = (step as u64, self.shape.voxels);
        let chosen = if self.time_first {
            ValueSelection { first: step, stride: self.shape.steps as u64, count }
        } else {
            ValueSelection { first: step * count as u64, stride: 1, count }
        };
        self.data.read(chosen, out)
    }

    fn read_range(&self, steps: Range<usize>, out: &mut Vec<f32>) -> Result<(), VolumeError> {
        let Some(last) = steps.end.checked_sub(1).filter(|last| *last >= steps.start) else {
            out.clear();
            return Ok(());
        };
        common::check_step(&self.path, last, self.shape.steps)?;
        let (voxels, all) = (self.shape.voxels, self.shape.steps);
        if !self.time_first {
            common::prepare(&self.path, out, voxels.saturating_mul(steps.len()))?;
            let first = steps.start as u64 * voxels as u64;
            return self.data.read(ValueSelection { first, stride: 1, count: out.len() }, out);
        }
        if steps.len() < all {
            let mut one = Vec::new();
            common::reserve(&self.path, out, voxels.saturating_mul(steps.len()))?;
            return steps.into_iter().try_for_each(|step| {
                self.read(step, &mut one)?;
                out.extend_from_slice(&one);
                Ok(())
            });
        }
        // as stored, the steps of each voxel lie together
        let mut stored = Vec::new();
        common::prepare(&self.path, &mut stored, voxels.saturating_mul(all))?;
        self.data.read(ValueSelection { first: 0, stride: 1, count: stored.len() }, &mut stored)?;
        common::reserve(&self.path, out, voxels.saturating_mul(steps.len()))?;
        out.extend(steps.flat_map(|step| stored.iter().skip(step).step_by(all)));
        Ok(())
    }
}
