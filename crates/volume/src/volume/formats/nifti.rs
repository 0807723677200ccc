//! NIfTI-1 images (`.nii`, `.nii.gz`), 3D or 4D with time as the fourth axis. The header is read by the `nifti` crate;
//! the values are streamed here, so that only the requested steps of a 4D file are held.

mod space;
#[cfg(test)]
mod tests;

use super::common;
use super::decode::Endian;
use super::stream::{read_error, read_values};
use crate::files::open_regular;
use crate::volume::error::VolumeError;
use crate::volume::grid::ScalarType;
use crate::volume::source::{VolumeFile, VolumeHeader};
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
    let io_error = |e| VolumeError::io(path, "read the file", e, "check the disk");
    let (mut file, file_len) = common::open_file(path)?;
    let mut magic = Vec::new();
    file.by_ref().take(2).read_to_end(&mut magic).map_err(io_error)?;
    file.rewind().map_err(io_error)?;
    let gz = magic == [0x1f, 0x8b];
    let raw = if gz { from_stream(path, MultiGzDecoder::new(BufReader::new(file))) } else { from_stream(path, file) }?;
    let mut notes = Vec::new();
    let (dims, steps) = dims(path, &raw)?;
    let (grid, physical) = space::read(path, &raw, dims, steps, &mut notes)?;
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
    let header = VolumeHeader { grid, scalar: kind, steps, physical, notes };
    let endian = if raw.endianness == Endianness::Big { Endian::Big } else { Endian::Little };
    Ok(Box::new(Nifti { path: path.to_owned(), header, gz, start, kind, endian, scale: scale(&raw) }))
}

/// An open NIfTI file: what to read, and where.
#[derive(Debug)]
struct Nifti {
    path: PathBuf,
    header: VolumeHeader,
    gz: bool,
    /// First byte of the values, in the decompressed stream.
    start: u64,
    kind: ScalarType,
    endian: Endian,
    scale: Option<(f64, f64)>,
}

impl VolumeFile for Nifti {
    fn header(&self) -> &VolumeHeader {
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
            return read_values(&mut file, self.kind, self.endian, count, self.scale, out);
        }
        let mut stream = MultiGzDecoder::new(BufReader::new(file));
        if io::copy(&mut stream.by_ref().take(skip), &mut io::sink())? < skip {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        read_values(&mut stream, self.kind, self.endian, count, self.scale, out)
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

/// The voxels of a step and the number of steps.
fn dims(path: &Path, raw: &NiftiHeader) -> Result<([usize; 3], usize), VolumeError> {
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
    Ok(([size(0), size(1), size(2)], size(3)))
}
