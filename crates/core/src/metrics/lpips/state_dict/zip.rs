//! The container of `torch.save` since PyTorch 1.6: a zip archive, never compressed, with the pickle in `NAME/data.pkl`
//! and each storage in `NAME/data/KEY`.

use super::{
    DESCRIPTION, Result, StateDictError, TensorLocation, bytes_at, checksum, damaged, pickle, places, unsupported,
};
use rawzip::{CompressionMethod, ErrorKind, RECOMMENDED_BUFFER_SIZE, ZipArchive};
use std::collections::{BTreeMap, HashMap};
use std::io::{self, Read, Seek};

/// Signature of an entry, and so of the file.
pub(super) const LOCAL: &[u8] = b"PK\x03\x04";

/// The position of a stored entry's bytes.
#[derive(Clone, Copy, Debug)]
struct ZipEntry {
    at: u64,
    length: u64,
    crc: u32,
}

/// The tensors of an archive of `length` bytes.
pub(super) fn tensors(file: &mut (impl Read + Seek), length: u64) -> Result<BTreeMap<String, TensorLocation>> {
    let entries = directory(file, length)?;
    let name = "data.pkl";
    let pickles = entries.iter().filter_map(|(n, e)| Some((n.strip_suffix(name)?, e)));
    let found = pickles.filter(|(root, _)| root.is_empty() || root.ends_with('/')).min_by_key(|(root, _)| root.len());
    let Some((root, entry)) = found else { return unsupported(format!("a zip archive without {name}")) };
    if let Some(order) = entries.get(&format!("{root}byteorder"))
        && bytes_at(file, order.at, order.length.min(8))? != b"little"
    {
        return unsupported("it was not written on a little-endian machine");
    }
    if entry.length > DESCRIPTION as u64 {
        return unsupported(format!("{name} has {} bytes; networks need a few thousand", entry.length));
    }
    let bytes = bytes_at(file, entry.at, entry.length)?;
    if entry.crc != 0 && entry.crc != checksum(&bytes) {
        return damaged(format!("the checksum of {name} is wrong"));
    }
    let pickle = pickle::read(&bytes)?;
    places(pickle.tensors(), |tensor| match entries.get(&format!("{root}data/{}", tensor.storage.key)) {
        // a checksum of 0 was never computed
        Some(entry) => Ok((entry.at, entry.length, Some(entry.crc).filter(|crc| *crc != 0))),
        None => damaged(format!("storage {} is missing", tensor.storage.key)),
    })
}

fn cut() -> StateDictError {
    StateDictError::Damaged("it is not a complete zip archive".into())
}

/// The error of an archive that cannot be read: the system's, or else that it is not complete.
fn unreadable(error: rawzip::Error) -> StateDictError {
    match error.into_kind() {
        ErrorKind::IO(error) if error.kind() != io::ErrorKind::UnexpectedEof => error.into(),
        _ => cut(),
    }
}

/// All entries by name, each within the file.
fn directory(file: &mut (impl Read + Seek), length: u64) -> Result<HashMap<String, ZipEntry>> {
    let mut buffer = vec![0; RECOMMENDED_BUFFER_SIZE];
    let archive = ZipArchive::from_seekable(file, &mut buffer).map_err(unreadable)?;
    let size = archive.eocd_offset().saturating_sub(archive.directory_offset());
    if size > DESCRIPTION as u64 {
        return unsupported(format!("a zip archive with a directory of {size} bytes"));
    }
    let mut entries = HashMap::new();
    let mut records = archive.entries(&mut buffer);
    while let Some(record) = records.next_entry().map_err(unreadable)? {
        let name = String::from_utf8_lossy(record.file_path().as_ref()).into_owned();
        if record.compression_method() != CompressionMethod::STORE {
            return unsupported(format!(
                "{name} is compressed, which torch.save does not do; unpack and save it uncompressed"
            ));
        }
        let (at, end) = archive.get_entry(record.wayfinder()).map_err(unreadable)?.compressed_data_range();
        let size = record.uncompressed_size_hint();
        if size != record.compressed_size_hint() || end > length {
            return Err(cut());
        }
        entries.insert(name, ZipEntry { at, length: size, crc: record.crc32() });
    }
    Ok(entries)
}
