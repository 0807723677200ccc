//! NumPy `.npy` arrays `[z, y, x]` or `[t, z, y, x]`, in C or Fortran order. The header is parsed here by hand:
//! one flat dictionary, no nesting, so that no header can exhaust the stack or the memory.

use super::common::{self, VolumeShape};
use super::decode::{Endian, decode_into};
use super::sidecar::{self, PlaceSidecar};
use crate::files::{MARK, has_mark};
use crate::volume::error::VolumeError;
use crate::volume::grid::ScalarType;
use crate::volume::source::{VolumeFile, VolumeHeader};
use rayon::prelude::*;
use std::io::Read;
use std::path::{Path, PathBuf};

/// NumPy writes about a hundred bytes; anything longer is not the header of a plain array.
const MAX_HEADER: usize = 1 << 16;

/// An array of uncompressed values in a file.
#[derive(Debug)]
pub(super) struct ArrayFile {
    pub path: PathBuf,
    pub header: VolumeHeader,
    pub shape: VolumeShape,
    pub endian: Endian,
    /// Bytes before the first value.
    pub offset: u64,
    /// Whether time is the fastest axis and x the slowest, instead of the reverse.
    pub fortran: bool,
}

/// Opens an array: reads its header and the sidecar `NAME.npy.toml` or `NAME.npy.json` with `spacing` and `origin`, if
/// present.
///
/// # Errors
/// Not an array of three or four axes of a known type, or a file size that does not match.
pub fn open(path: &Path) -> Result<Box<dyn VolumeFile>, VolumeError> {
    let (mut file, found) = common::open_file(path)?;
    let bad = |field: &str, problem: String, hint: &str| VolumeError::invalid(path, field, problem, hint);
    let again = "write it again with numpy.save";
    let short = |e| VolumeError::io(path, "read the header", e, again);

    let mut start = [0u8; 8];
    file.read_exact(&mut start).map_err(short)?;
    if !start.starts_with(b"\x93NUMPY") {
        return Err(bad("magic", "is not that of a NumPy array".into(), again));
    }
    let width = match start[6] {
        1 => 2,
        2 | 3 => 4,
        v => return Err(bad("version", format!("{v} is not supported"), again)),
    };
    let mut length = [0u8; 4];
    file.read_exact(&mut length[..width]).map_err(short)?;
    let length = u32::from_le_bytes(length) as usize;
    if length > MAX_HEADER {
        return Err(bad("header", format!("claims {length} bytes, at most {MAX_HEADER} are supported"), again));
    }
    let mut text = vec![0; length];
    file.read_exact(&mut text).map_err(short)?;
    let text = std::str::from_utf8(&text).map_err(|_| bad("header", "is not text".into(), again))?;

    let fields = dictionary(text).map_err(|problem| bad("header", problem, again))?;
    let (Some(descr), Some(fortran), Some(axes)) = (fields.descr, fields.fortran, fields.shape) else {
        return Err(bad("header", "lacks descr, fortran_order or shape".into(), again));
    };
    let (scalar, endian) = scalar_of(&descr).ok_or_else(|| {
        let (what, hint) = not_read(&descr);
        bad("descr", format!("the type '{descr}'{what} is not supported"), hint)
    })?;
    let (dims, steps) = match axes[..] {
        [z, y, x] => ([x, y, z], 1),
        [t, z, y, x] => ([x, y, z], t),
        _ => {
            let problem = format!("the array has {} axes", axes.len());
            return Err(bad("shape", problem, "save it as [z, y, x] or [t, z, y, x]"));
        }
    };
    let shape = VolumeShape::new(path, "shape", dims, steps, scalar)?;
    let offset = (8 + width + length) as u64;
    let excess = found.checked_sub(offset).and_then(|bytes| bytes.checked_sub(shape.total_bytes));
    // this program's own arrays end with its mark
    let marked = excess == Some(MARK.len() as u64) && has_mark(path).map_err(short)?;
    if excess != Some(0) && !marked {
        let problem = format!(
            "expected {} bytes of values for {axes:?} {}, found {}",
            shape.total_bytes,
            scalar.name(),
            found.saturating_sub(offset)
        );
        return Err(bad("size", problem, again));
    }
    let beside = [".toml", ".json"].map(|s| sidecar::with_suffix(path, s));
    let side = sidecar::only(path, &beside)?;
    let place: PlaceSidecar = side.as_deref().map(sidecar::read).transpose()?.unwrap_or_default();
    let from = side.as_deref().unwrap_or(path);
    let (grid, physical) = common::placed(from, shape.dims, place.spacing, place.origin)?;
    let header = VolumeHeader { grid, scalar, steps: shape.steps, physical, notes: Vec::new() };
    Ok(Box::new(ArrayFile { path: path.to_owned(), header, shape, endian, offset, fortran }))
}

impl VolumeFile for ArrayFile {
    fn header(&self) -> &VolumeHeader {
        &self.header
    }

    fn read(&self, step: usize, out: &mut Vec<f32>) -> Result<(), VolumeError> {
        common::check_step(&self.path, step, self.shape.steps)?;
        let (scalar, endian) = (self.header.scalar, self.endian);
        if !self.fortran {
            let from = self.offset + step as u64 * self.shape.step_bytes;
            let map = common::map(&self.path, from, self.shape.step_bytes)?;
            common::prepare(&self.path, out, self.shape.voxels)?;
            decode_into(&map, scalar, endian, 0, 1, out);
            return Ok(());
        }
        // The first axis is the fastest: t, then z, then y, then x.
        let map = common::map(&self.path, self.offset, self.shape.total_bytes)?;
        common::prepare(&self.path, out, self.shape.voxels)?;
        let ([nx, ny, nz], nt) = (self.shape.dims, self.shape.steps);
        out.par_chunks_mut(nx).enumerate().for_each(|(row, line)| {
            let (y, z) = (row % ny, row / ny);
            decode_into(&map, scalar, endian, step + nt * (z + nz * y), nt * nz * ny, line);
        });
        Ok(())
    }
}

fn scalar_of(descr: &str) -> Option<(ScalarType, Endian)> {
    let (order, kind) = descr.split_at_checked(1)?;
    let scalar = match kind.split_at_checked(1)? {
        ("b", "1") => ScalarType::U8,
        (letter @ ("u" | "i" | "f"), bytes @ ("1" | "2" | "4" | "8")) => {
            common::scalar_from_name(&format!("{letter}{}", 8 * bytes.parse::<usize>().ok()?))?
        }
        _ => return None,
    };
    match order {
        "<" => Some((scalar, Endian::Little)),
        ">" => Some((scalar, Endian::Big)),
        "|" if scalar.bytes() == 1 => Some((scalar, Endian::Little)),
        _ => None,
    }
}

/// What a type that is not read is, and what to do.
fn not_read(descr: &str) -> (&'static str, &'static str) {
    match descr.trim_start_matches(['<', '>', '|', '=']).chars().next() {
        Some('c') => (", complex numbers,", "save a real part: numpy.abs(a), a.real or a.imag"),
        Some('f') => (", long double,", "save it with a.astype(\"float64\")"),
        Some('O') => (", Python objects,", "save an array of numbers, as with numpy.array(a, dtype=\"float32\")"),
        Some('U' | 'S' | 'a') => (", text,", "save an array of numbers, as with a.astype(\"float32\")"),
        Some('M' | 'm') => (", dates or durations,", "save them as numbers, as with a.astype(\"int64\")"),
        _ => ("", "save it with a.astype(\"float32\"); bool, integers, float16, float32 and float64 are supported"),
    }
}

#[derive(Default)]
struct NpyHeaderFields {
    descr: Option<String>,
    fortran: Option<bool>,
    shape: Option<Vec<u64>>,
}

/// Parses `{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3, 4), }`.
fn dictionary(text: &str) -> Result<NpyHeaderFields, String> {
    let mut fields = NpyHeaderFields::default();
    let body = text.trim().strip_prefix('{').and_then(|t| t.strip_suffix('}'));
    let mut rest = body.ok_or("is not a dictionary")?.trim();
    while !rest.is_empty() {
        let (key, after) = quoted(rest).ok_or("has a key without quotes")?;
        let value = after.trim_start().strip_prefix(':').ok_or_else(|| format!("has no value of {key}"))?.trim_start();
        let after = match key {
            "descr" => {
                let (descr, after) = quoted(value).ok_or_else(|| structured(value))?;
                fields.descr = Some(descr.to_owned());
                after
            }
            "fortran_order" => {
                let yes = value.strip_prefix("True").map(|a| (true, a));
                let (order, after) = yes
                    .or_else(|| value.strip_prefix("False").map(|a| (false, a)))
                    .ok_or("has a fortran_order that is not True or False")?;
                fields.fortran = Some(order);
                after
            }
            "shape" => {
                let inner = value.strip_prefix('(').and_then(|v| v.split_once(')'));
                let (list, after) = inner.ok_or("has a shape that is not a tuple")?;
                let sizes = list.split(',').map(str::trim).filter(|s| !s.is_empty());
                let sizes: Result<Vec<u64>, _> = sizes.map(|s| s.trim_end_matches('L').parse()).collect();
                fields.shape = Some(sizes.map_err(|_| format!("has a shape that is not of whole numbers, ({list})"))?);
                after
            }
            other => return Err(format!("has an unknown key {other}")),
        };
        let after = after.trim_start();
        rest = match after.strip_prefix(',') {
            Some(more) => more.trim_start(),
            None if after.is_empty() => after,
            None => return Err("lacks a comma between its entries".into()),
        };
    }
    Ok(fields)
}

/// The problem of a structured type, which is a list of fields: `[('rho', '<f4'), ('u', '<f4')]`.
fn structured(list: &str) -> String {
    let fields = list.split('(').skip(1).filter_map(quoted).map(|(name, _)| name);
    let fields: Vec<&str> = fields.take(8).collect();
    let first = fields.first().unwrap_or(&"rho");
    format!("describes a structured type of the fields {}; save one of them, as in a[\"{first}\"]", fields.join(", "))
}

/// A quoted string at the start of `text`, and what follows it.
fn quoted(text: &str) -> Option<(&str, &str)> {
    let mark = text.chars().next().filter(|c| matches!(c, '\'' | '"'))?;
    text[1..].split_once(mark)
}
