//! Converts a stream of stored numbers to `f32`, a chunk at a time, for the readers of whole formats. Knows number
//! types and byte order only: where the numbers lie in a file is known to the readers.

use super::decode::{Endian, decode_scaled};
use crate::volume::error::VolumeError;
use crate::volume::grid::ScalarType;
use std::io::{self, ErrorKind, Read};
use std::path::Path;

/// Bytes converted at a time; a multiple of every number size.
const CHUNK: usize = 64 * 1024;

/// Reads exactly `count` numbers from `src` and appends them to `out`, as `slope * x + inter` where `scale` holds
/// `(slope, inter)`.
///
/// # Errors
/// Errors of `src`; `UnexpectedEof` if it ends early; `OutOfMemory` if `out` cannot grow.
pub fn read_values(
    src: &mut impl Read,
    kind: ScalarType,
    endian: Endian,
    count: usize,
    scale: Option<(f64, f64)>,
    out: &mut Vec<f32>,
) -> io::Result<()> {
    reserve(out, count)?;
    let mut buf = vec![0u8; CHUNK];
    let mut left = count;
    while left > 0 {
        let n = left.min(CHUNK / kind.bytes());
        let bytes = &mut buf[..n * kind.bytes()];
        src.read_exact(bytes)?;
        let start = out.len();
        out.resize(start + n, 0.0);
        decode_scaled(bytes, kind, endian, scale, 0, 1, &mut out[start..]);
        left -= n;
    }
    Ok(())
}

/// Reserves room for `count` more values; returns an error instead of aborting.
pub fn reserve(out: &mut Vec<f32>, count: usize) -> io::Result<()> {
    out.try_reserve_exact(count)
        .map_err(|e| io::Error::new(ErrorKind::OutOfMemory, format!("no memory for {count} values: {e}")))
}

/// Translates a failed read of `field`: truncated, damaged, or refused by the system.
pub fn read_error(path: &Path, field: &str, error: io::Error) -> VolumeError {
    match error.kind() {
        ErrorKind::UnexpectedEof => VolumeError::invalid(
            path,
            field,
            "the data ends before the last voxel",
            "the file is truncated: copy or write it again",
        ),
        ErrorKind::InvalidData | ErrorKind::InvalidInput => {
            VolumeError::invalid(path, field, error.to_string(), "the file is damaged: copy or write it again")
        }
        ErrorKind::OutOfMemory => {
            VolumeError::io(path, "hold the values", error, "free memory or make a smaller volume")
        }
        _ => VolumeError::io(path, "read the values", error, "check that the file is readable and complete"),
    }
}

/// An error that [`read_error`] reports as damage.
pub fn damaged(message: impl Into<String>) -> io::Error {
    io::Error::new(ErrorKind::InvalidData, message.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use half::f16;

    fn read(bytes: &[u8], kind: ScalarType, big: bool, scale: Option<(f64, f64)>) -> Vec<f32> {
        let mut out = Vec::new();
        let endian = if big { Endian::Big } else { Endian::Little };
        read_values(&mut &bytes[..], kind, endian, bytes.len() / kind.bytes(), scale, &mut out).unwrap();
        out
    }

    #[test]
    fn every_type_and_both_byte_orders() {
        assert_eq!(read(&[255, 1], ScalarType::U8, false, None), [255.0, 1.0]);
        assert_eq!(read(&[255, 1], ScalarType::I8, true, None), [-1.0, 1.0]);
        assert_eq!(read(&[1, 2], ScalarType::U16, false, None), [513.0]);
        assert_eq!(read(&[1, 2], ScalarType::U16, true, None), [258.0]);
        assert_eq!(read(&(-5i16).to_be_bytes(), ScalarType::I16, true, None), [-5.0]);
        assert_eq!(read(&7u32.to_le_bytes(), ScalarType::U32, false, None), [7.0]);
        assert_eq!(read(&(-7i32).to_le_bytes(), ScalarType::I32, false, None), [-7.0]);
        assert_eq!(read(&(1u64 << 40).to_le_bytes(), ScalarType::U64, false, None), [(1u64 << 40) as f32]);
        assert_eq!(read(&(-9i64).to_be_bytes(), ScalarType::I64, true, None), [-9.0]);
        assert_eq!(read(&f16::from_f32(0.75).to_be_bytes(), ScalarType::F16, true, Some((2.0, 1.0))), [2.5]);
        assert_eq!(read(&1.5f32.to_be_bytes(), ScalarType::F32, true, None), [1.5]);
        assert_eq!(read(&2.5f64.to_le_bytes(), ScalarType::F64, false, Some((2.0, 1.0))), [6.0]);
    }

    #[test]
    fn more_than_one_chunk_and_a_short_stream() {
        let bytes: Vec<u8> = (0..CHUNK + 10).map(|i| i as u8).collect();
        let got = read(&bytes, ScalarType::U8, false, None);
        assert!(got.iter().zip(&bytes).all(|(a, b)| *a == f32::from(*b)) && got.len() == bytes.len());
        let short =
            read_values(&mut &bytes[..3], ScalarType::U16, Endian::Little, 2, None, &mut Vec::new()).unwrap_err();
        assert!(read_error(Path::new("a.x"), "f", short).to_string().contains("truncated"));
    }
}
