//! NIfTI-1 images (`.nii`, `.nii.gz`), 3D or 4D with time as the fourth axis. The header is read by the `nifti` crate;
//! the values are streamed here, so that only the requested steps of a 4D file are held.

#[cfg(test)]
mod tests;

use super::common;
use super::stream::{read_error, read_values};
use crate::files::open_regular;
use crate::volume::error::VolumeError;
use crate::volume::grid::{Grid, ScalarType};
use crate::volume::source::{Header, VolumeFile};
use flate2::read::MultiGzDecoder;
use nifti::{Endianness, NiftiError, NiftiHeader, NiftiType};
use std::io::{self, BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Maximum expansion of gzip.
const GZIP_RATIO: u64 = 1032;
/// Bytes of a NIfTI-1 header.
const HEADER: i32 = 348;
/// Bytes of a NIfTI-2 header.
const HEADER_2: i32 = 540;
const CONVERT: &str = "convert it to a single .nii or .nii.gz file (NIfTI-1), for example with nibabel";
const REWRITE: &str = "the file is damaged or truncated: copy or write it again";

/// Opens a `.nii` or `.nii.gz` file and reads its header; the values stay on disk. Whether it is compressed is decided
/// by its first bytes, not by its name.
///
/// # Errors
/// An unreadable file, one that is not a single-file NIfTI-1 image of real numbers, or one that claims more values
/// than it can hold.
pub fn open(path: &Path) -> Result<Box<dyn VolumeFile>, VolumeError> {
    let name = path.to_string_lossy().to_ascii_lowercase();
    if [".hdr", ".img", ".hdr.gz", ".img.gz"].iter().any(|e| name.ends_with(e)) {
        return Err(VolumeError::invalid(path, "format", "a .hdr/.img pair is not supported", CONVERT));
    }
    let io_error = |e| VolumeError::io(path, "read the file", e, "check the disk");
    let (mut file, file_len) = common::open_file(path)?;
    let mut magic = Vec::new();
    file.by_ref().take(2).read_to_end(&mut magic).map_err(io_error)?;
    file.rewind().map_err(io_error)?;
    let gz = magic == [0x1f, 0x8b];
    let raw = if gz { from_stream(path, MultiGzDecoder::new(BufReader::new(file))) } else { from_stream(path, file) }?;
    let mut notes = Vec::new();
    let (grid, steps) = grid(path, &raw, &mut notes)?;
    let kind = kind(path, &raw)?;
    let start = start(path, &raw)?;
    let total = [grid.dims[0], grid.dims[1], grid.dims[2], steps, kind.bytes()]
        .iter()
        .try_fold(1u64, |n, d| n.checked_mul(*d as u64))
        .and_then(|n| n.checked_add(start));
    let held = if gz { file_len.saturating_mul(GZIP_RATIO) } else { file_len };
    if total.is_none_or(|n| n > held || usize::try_from(n).is_err()) {
        let problem =
            format!("{:?} voxels in {steps} steps are more than the file of {file_len} bytes can hold", grid.dims);
        return Err(VolumeError::invalid(path, "dim", problem, REWRITE));
    }
    let header = Header { grid, scalar: kind, steps, notes };
    let big_endian = raw.endianness == Endianness::Big;
    Ok(Box::new(Nifti { path: path.to_owned(), header, gz, start, kind, big_endian, scale: scale(&raw) }))
}

/// An open NIfTI file: what to read, and where.
#[derive(Debug)]
struct Nifti {
    path: PathBuf,
    header: Header,
    gz: bool,
    /// First byte of the values, in the decompressed stream.
    start: u64,
    kind: ScalarType,
    big_endian: bool,
    scale: Option<(f64, f64)>,
}

impl VolumeFile for Nifti {
    fn header(&self) -> &Header {
        &self.header
    }

    fn read(&self, step: usize, out: &mut Vec<f32>) -> Result<(), VolumeError> {
        let Some(end) = step.checked_add(1) else { return Err(self.no_step(step)) };
        self.read_range(step..end, out)
    }

    fn read_range(&self, steps: Range<usize>, out: &mut Vec<f32>) -> Result<(), VolumeError> {
        out.clear();
        let Some(first) = steps.clone().next() else { return Ok(()) };
        if steps.end > self.header.steps {
            return Err(self.no_step(steps.end - 1));
        }
        // no more than the file claims, which was checked against what it can hold
        let count = self.header.grid.len() * steps.len();
        common::reserve(&self.path, out, count)?;
        self.read_from(first, count, out).map_err(|e| read_error(&self.path, &format!("step {first}"), e))
    }
}

impl Nifti {
    fn no_step(&self, step: usize) -> VolumeError {
        let hint = format!("the file has {} steps, counted from 0", self.header.steps);
        VolumeError::invalid(&self.path, "step", format!("no step {step}"), hint)
    }

    /// Reads `count` values from the beginning of `step` on.
    fn read_from(&self, step: usize, count: usize, out: &mut Vec<f32>) -> io::Result<()> {
        let skip = self.start + step as u64 * (self.header.grid.len() * self.kind.bytes()) as u64;
        let mut file = open_regular(&self.path)?;
        if !self.gz {
            file.seek(SeekFrom::Start(skip))?;
            return read_values(&mut file, self.kind, self.big_endian, count, self.scale, out);
        }
        let mut stream = MultiGzDecoder::new(BufReader::new(file));
        if io::copy(&mut stream.by_ref().take(skip), &mut io::sink())? < skip {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        read_values(&mut stream, self.kind, self.big_endian, count, self.scale, out)
    }
}

fn from_stream(path: &Path, mut src: impl Read) -> Result<NiftiHeader, VolumeError> {
    // the size field comes first and distinguishes NIfTI-1 from NIfTI-2 and from other files
    let mut bytes = [0u8; HEADER as usize];
    src.read_exact(&mut bytes).map_err(|e| read_error(path, "header", e))?;
    let size = i32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    if size == HEADER_2 || size.swap_bytes() == HEADER_2 {
        return Err(VolumeError::invalid(path, "sizeof_hdr", "NIfTI-2 is not supported", CONVERT));
    }
    let header = NiftiHeader::from_reader(&bytes[..]).map_err(|e| match e {
        NiftiError::Io(e) => read_error(path, "header", e),
        e => VolumeError::invalid(path, "header", e.to_string(), "give a NIfTI-1 file (.nii or .nii.gz)"),
    })?;
    if header.sizeof_hdr != HEADER {
        let problem = format!("is {}, not {HEADER}", header.sizeof_hdr);
        return Err(VolumeError::invalid(path, "sizeof_hdr", problem, "give a NIfTI-1 file (.nii or .nii.gz)"));
    }
    if &header.magic != b"n+1\0" {
        return Err(VolumeError::invalid(path, "magic", "the header of a .hdr/.img pair is not supported", CONVERT));
    }
    Ok(header)
}

fn kind(path: &Path, raw: &NiftiHeader) -> Result<ScalarType, VolumeError> {
    let bad = |problem: String, hint: &str| Err(VolumeError::invalid(path, "datatype", problem, hint));
    let kind = match raw.data_type() {
        Ok(NiftiType::Uint8) => ScalarType::U8,
        Ok(NiftiType::Int8) => ScalarType::I8,
        Ok(NiftiType::Uint16) => ScalarType::U16,
        Ok(NiftiType::Int16) => ScalarType::I16,
        Ok(NiftiType::Uint32) => ScalarType::U32,
        Ok(NiftiType::Int32) => ScalarType::I32,
        Ok(NiftiType::Uint64) => ScalarType::U64,
        Ok(NiftiType::Int64) => ScalarType::I64,
        Ok(NiftiType::Float32) => ScalarType::F32,
        Ok(NiftiType::Float64) => ScalarType::F64,
        Ok(other) => {
            let hint = "write one real number per voxel, of at most 64 bits (for example the magnitude)";
            return bad(format!("{other:?} values are not a scalar field"), hint);
        }
        Err(_) => return bad(format!("unknown code {}", raw.datatype), "write float32 or an integer type"),
    };
    if raw.bitpix != 0 && i64::from(raw.bitpix) != 8 * kind.bytes() as i64 {
        return bad(format!("{} bits in bitpix contradict {kind:?}", raw.bitpix), REWRITE);
    }
    Ok(kind)
}

/// First byte of the values.
fn start(path: &Path, raw: &NiftiHeader) -> Result<u64, VolumeError> {
    let offset = raw.vox_offset;
    if !(offset.is_finite() && offset >= HEADER as f32 && offset < 2f32.powi(40)) {
        return Err(VolumeError::invalid(path, "vox_offset", format!("is {offset}, inside the header"), REWRITE));
    }
    Ok(offset as u64)
}

/// `(slope, inter)`, or `None` where the header asks for no scaling: a slope of 0 or (as written by nibabel) NaN.
fn scale(raw: &NiftiHeader) -> Option<(f64, f64)> {
    let inter = if raw.scl_inter.is_finite() { f64::from(raw.scl_inter) } else { 0.0 };
    let slope = f64::from(raw.scl_slope);
    (slope.is_finite() && slope != 0.0 && (slope, inter) != (1.0, 0.0)).then_some((slope, inter))
}

fn grid(path: &Path, raw: &NiftiHeader, notes: &mut Vec<String>) -> Result<(Grid, usize), VolumeError> {
    let bad = |problem: String, hint: &str| VolumeError::invalid(path, "dim", problem, hint);
    let dim = raw.dim().map_err(|e| bad(e.to_string(), REWRITE))?;
    // the format's sizes are signed: the crate reads a negative one as a large one
    if let Some(d) = dim.iter().find(|d| **d > i16::MAX as u16) {
        return Err(bad(format!("a size of {}", *d as i16), REWRITE));
    }
    if dim.iter().skip(4).any(|d| *d != 1) {
        return Err(bad(format!("{dim:?} has more axes than x, y, z, time"), "write one component per voxel"));
    }
    let size = |a: usize| dim.get(a).map_or(1, |d| usize::from(*d));
    let mut grid = Grid::unit([size(0), size(1), size(2)]);
    for a in 0..3.min(dim.len()) {
        let spacing = f64::from(raw.pixdim[a + 1]).abs();
        if !spacing.is_finite() {
            let problem = format!("axis {a}: {spacing}");
            return Err(VolumeError::invalid(path, "pixdim", problem, "write finite, positive spacings"));
        }
        if spacing == 0.0 {
            notes.push(format!("pixdim: spacing 0 along axis {a} replaced by 1"));
        } else {
            grid.spacing[a] = spacing;
        }
    }
    if raw.xyzt_units != 0 {
        notes.push("units ignored (xyzt_units): spacing is in the file's units".to_owned());
    }
    let (offset, aligned) = placement(raw);
    if raw.sform_code > 0 {
        take_lengths(raw, &mut grid.spacing, notes);
    }
    if offset.iter().all(|v| v.is_finite()) {
        grid.origin = offset.map(f64::from);
    } else {
        notes.push("origin ignored: it is not finite".to_owned());
    }
    common::check_spacing(path, "pixdim", grid.spacing)?;
    common::check_origin(path, "offset of the first voxel", grid.origin)?;
    if !aligned {
        notes.push("orientation ignored: the axes are used as stored".to_owned());
    }
    Ok((grid, size(3)))
}

/// Position of the first voxel, and whether the voxel axes are those of space: from the sform, else the qform.
fn placement(raw: &NiftiHeader) -> ([f32; 3], bool) {
    if raw.sform_code > 0 {
        let rows = [raw.srow_x, raw.srow_y, raw.srow_z];
        let aligned = (0..3).all(|r| {
            let tiny = 1e-4 * rows[r][r];
            rows[r][r] > 0.0 && (0..3).all(|c| c == r || rows[r][c].abs() <= tiny)
        });
        return ([rows[0][3], rows[1][3], rows[2][3]], aligned);
    }
    if raw.qform_code > 0 {
        let turn = [raw.quatern_b, raw.quatern_c, raw.quatern_d];
        let aligned = raw.pixdim[0] >= 0.0 && turn.iter().all(|q| q.abs() <= 1e-4);
        return ([raw.quatern_x, raw.quatern_y, raw.quatern_z], aligned);
    }
    ([0.0; 3], true)
}

/// Takes the lengths of the columns of the sform, from which the offset is taken too, as spacing where they contradict
/// `pixdim`: some programs change only the one.
fn take_lengths(raw: &NiftiHeader, spacing: &mut [f64; 3], notes: &mut Vec<String>) {
    let rows = [raw.srow_x, raw.srow_y, raw.srow_z];
    for (axis, spacing) in spacing.iter_mut().enumerate() {
        let length = rows.iter().map(|row| f64::from(row[axis]).powi(2)).sum::<f64>().sqrt();
        if length.is_finite() && length > 0.0 && (length / *spacing - 1.0).abs() > 1e-3 {
            notes.push(format!("pixdim: spacing {spacing} along axis {axis} replaced by {length}, that of the sform"));
            *spacing = length;
        }
    }
}
