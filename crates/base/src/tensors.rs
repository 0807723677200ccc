//! Safetensors files with an integrity check: each holds a digest of itself, verified when it is read.
//!
//! The digest is a separate tensor, [`DIGEST`], so that any safetensors reader can still open the file. It covers all
//! bytes of the file, header included, with its own 16 bytes taken as zero: the file is divided into pieces of 1 MiB,
//! and the digest is the 128-bit XXH3 hash of the pieces' hashes in order. It protects against accidental corruption,
//! not against tampering. Pieces are hashed in parallel.

use crate::files::{open_regular, read_regular, write_atomic};
use half::f16;
use rayon::prelude::*;
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, SafeTensorError, TensorView};
use std::io::Read;
use std::path::{Path, PathBuf};
use twox_hash::XxHash3_128;

/// Name of the tensor that holds the digest, `[16]` bytes.
pub const DIGEST: &str = "volseggs.digest";
const LENGTH: usize = 16;
/// Bytes hashed at once.
const PIECE: usize = 1 << 20;
/// Length in bytes of the field before the header that holds the header's length.
const PREFIX: usize = 8;
/// Length in bytes of the longest header that the format allows.
const LONGEST_HEADER: u64 = 100_000_000;

/// Why a tensor file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TensorFileError {
    /// The file cannot be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What happened.
        source: std::io::Error,
    },
    /// The bytes are not those that were written.
    #[error("{path}: damaged: {reason}")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// How it is damaged.
        reason: String,
    },
}

/// Writes named tensors and one header entry, atomically, with a digest. The same content gives the same bytes.
///
/// # Errors
/// If the file cannot be written, or a view does not fit its bytes.
pub fn write(
    path: &Path,
    tensors: Vec<(&str, TensorView<'_>)>,
    entry: Option<(&str, String)>,
) -> Result<(), TensorFileError> {
    let wrong = |e: SafeTensorError| TensorFileError::Io { path: path.into(), source: std::io::Error::other(e) };
    let zero = [0; LENGTH];
    let mut all = tensors;
    all.push((DIGEST, TensorView::new(Dtype::U8, vec![LENGTH], &zero).map_err(wrong)?));
    // only one entry, as the library writes several in an order that changes from run to run
    let header = entry.map(|(key, value)| [(key.to_owned(), value)].into_iter().collect());
    let mut bytes = safetensors::serialize(all, header).map_err(wrong)?;
    sign(&mut bytes).map_err(wrong)?;
    write_atomic(path, &bytes).map_err(|source| TensorFileError::Io { path: path.into(), source })
}

/// Sets the digest of a tensor file to that of its content; a file without one is unchanged.
///
/// # Errors
/// If the bytes are not a safetensors file.
pub fn sign(bytes: &mut [u8]) -> Result<(), SafeTensorError> {
    let file = SafeTensors::deserialize(bytes)?;
    if let Some(at) = digest_place(bytes, &file) {
        let digest = digest(bytes, at);
        bytes[at..at + LENGTH].copy_from_slice(&digest);
    }
    Ok(())
}

/// Returns the bytes of a tensor file after verifying its digest. A file without one, from another
/// program, is only checked for its format.
///
/// # Errors
/// If the file cannot be read, is not a safetensors file, or its bytes differ from those that were written.
pub fn read(path: &Path) -> Result<Vec<u8>, TensorFileError> {
    let bytes = read_bytes(path)?;
    check(path, &bytes, || ())?;
    Ok(bytes)
}

/// Returns the result of `make` for the bytes of a tensor file, while other threads check them as [`read`] does: if
/// `make` takes longer than hashing, the check costs no extra time. `make` may receive damaged bytes; its result is
/// then dropped.
///
/// # Errors
/// As [`read`].
pub fn read_while<T>(path: &Path, make: impl FnOnce(&[u8]) -> T) -> Result<T, TensorFileError> {
    let bytes = read_bytes(path)?;
    check(path, &bytes, || make(&bytes))
}

/// The entry `key` of a tensor file's header, of which nothing else is read or checked; `None` if it has no such entry
/// or cannot be read.
pub fn header_entry(path: &Path, key: &str) -> Option<String> {
    let mut file = open_regular(path).ok()?;
    let mut length = [0; PREFIX];
    file.read_exact(&mut length).ok()?;
    let length = u64::from_le_bytes(length);
    let mut header = Vec::new();
    let read = file.take(length.min(LONGEST_HEADER)).read_to_end(&mut header).ok()?;
    if read as u64 != length {
        return None;
    }
    let header: serde_json::Value = serde_json::from_slice(&header).ok()?;
    Some(header.get("__metadata__")?.get(key)?.as_str()?.to_owned())
}

/// The values of a tensor of type F32 or F16; `None` for any other type.
pub fn floats(tensor: &TensorView<'_>) -> Option<Vec<f32>> {
    let bytes = tensor.data();
    match tensor.dtype() {
        Dtype::F32 => Some(bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect()),
        Dtype::F16 => Some(bytes.as_chunks().0.iter().map(|b| f16::from_le_bytes(*b).to_f32()).collect()),
        _ => None,
    }
}

fn read_bytes(path: &Path) -> Result<Vec<u8>, TensorFileError> {
    read_regular(path).map_err(|source| TensorFileError::Io { path: path.into(), source })
}

/// Checks the format and the digest of a file's bytes while running `beside`.
fn check<T>(path: &Path, bytes: &[u8], beside: impl FnOnce() -> T) -> Result<T, TensorFileError> {
    let damaged = |reason: String| TensorFileError::Damaged { path: path.into(), reason };
    let file = SafeTensors::deserialize(bytes).map_err(|e| damaged(format!("not a complete safetensors file: {e}")))?;
    let Some(at) = digest_place(bytes, &file) else { return Ok(beside()) };
    let mut found = [0; LENGTH];
    // `beside` stays on this thread, so that the memory it allocates is freed and reused here
    let made = rayon::in_place_scope(|pool| {
        pool.spawn(|_| found = digest(bytes, at));
        beside()
    });
    if found == bytes[at..at + LENGTH] {
        Ok(made)
    } else {
        Err(damaged("its digest does not match its content".into()))
    }
}

/// The position of the digest's bytes in the file.
fn digest_place(bytes: &[u8], file: &SafeTensors<'_>) -> Option<usize> {
    let view = file.tensor(DIGEST).ok()?;
    let data = view.data();
    // a view is a slice of `bytes`
    let at = data.as_ptr() as usize - bytes.as_ptr() as usize;
    (data.len() == LENGTH && at >= PREFIX).then_some(at)
}

/// The digest of a file whose own digest begins at `at`.
fn digest(bytes: &[u8], at: usize) -> [u8; LENGTH] {
    let own = at..at + LENGTH;
    let hashes = bytes.par_chunks(PIECE).enumerate().map(|(number, piece)| {
        let start = number * PIECE;
        let (first, last) = (own.start.max(start), own.end.min(start + piece.len()));
        if first >= last {
            return XxHash3_128::oneshot(piece);
        }
        let mut piece = piece.to_vec();
        piece[first - start..last - start].fill(0);
        XxHash3_128::oneshot(&piece)
    });
    let mut whole = XxHash3_128::new();
    hashes.collect::<Vec<u128>>().iter().for_each(|hash| whole.write(&hash.to_be_bytes()));
    whole.finish_128().to_be_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(folder: &Path) -> PathBuf {
        let path = folder.join("x.safetensors");
        let data: Vec<u8> = (0..60u8).collect();
        let view = TensorView::new(Dtype::F32, vec![5, 3], &data).unwrap();
        write(&path, vec![("a", view)], Some(("spec", "{}".into()))).unwrap();
        path
    }

    #[test]
    fn every_changed_byte_and_every_truncation_is_detected() {
        let folder = tempfile::tempdir().unwrap();
        let path = file(folder.path());
        let whole = read(&path).unwrap();
        assert_eq!(read(&file(folder.path())).unwrap(), whole, "the same content gave different bytes");
        for i in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[i] ^= 0x20;
            std::fs::write(&path, &bytes).unwrap();
            let found = read(&path);
            // a renamed digest is a tensor of bytes that no reader here expects
            let renamed = found.as_ref().is_ok_and(|b| SafeTensors::deserialize(b).unwrap().tensor(DIGEST).is_err());
            assert!(found.is_err() || renamed, "byte {i}");
            std::fs::write(&path, &whole[..i]).unwrap();
            assert!(read(&path).is_err(), "cut at {i}");
        }
    }

    #[test]
    fn a_digest_across_two_pieces_does_not_cover_itself() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x");
        for extra in [0, 4, 8, 12, 16, 20] {
            let data = vec![7; 2 * PIECE - 400 + extra];
            let view = TensorView::new(Dtype::U8, vec![data.len()], &data).unwrap();
            // sorts after the digest's name, so that the digest is not at the end
            let first = vec![3; PIECE - 200 + extra];
            let before = TensorView::new(Dtype::U8, vec![first.len()], &first).unwrap();
            write(&path, vec![("a", before), ("z", view)], None).unwrap();
            let mut bytes = read(&path).unwrap();
            for at in [100, PIECE - 1, PIECE, 2 * PIECE, bytes.len() - 1] {
                bytes[at] ^= 1;
                std::fs::write(&path, &bytes).unwrap();
                assert!(read(&path).is_err(), "{extra} {at}");
                bytes[at] ^= 1;
            }
        }
    }

    #[test]
    fn an_entry_of_the_header_is_found_without_the_rest() {
        let folder = tempfile::tempdir().unwrap();
        let path = file(folder.path());
        let spec = Some("{}".to_owned());
        assert_eq!((header_entry(&path, "spec"), header_entry(&path, "other")), (spec.clone(), None));
        let whole = std::fs::read(&path).unwrap();
        let header = PREFIX + u64::from_le_bytes(whole[..PREFIX].try_into().unwrap()) as usize;
        for cut in 0..whole.len() {
            std::fs::write(&path, &whole[..cut]).unwrap();
            let found = header_entry(&path, "spec");
            assert_eq!(found, if cut < header { None } else { spec.clone() }, "cut at {cut} of a header of {header}");
        }
        // a length that is none, and what is no file of tensors
        for bytes in [&[0xff; 20][..], b"text, which is longer than eight bytes", b""] {
            std::fs::write(&path, bytes).unwrap();
            assert_eq!(header_entry(&path, "spec"), None);
        }
        assert_eq!(header_entry(folder.path(), "spec"), None);
    }

    #[test]
    fn a_file_of_another_program_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x");
        let view = TensorView::new(Dtype::U8, vec![2], &[1, 2]).unwrap();
        std::fs::write(&path, safetensors::serialize([("b", view)], None).unwrap()).unwrap();
        assert!(read(&path).is_ok());
        std::fs::write(&path, "no tensors").unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("not a complete safetensors file"));
    }
}
