//! The container of `torch.save` since PyTorch 1.6: a zip archive, never compressed, with the pickle in `NAME/data.pkl`
//! and each storage in `NAME/data/KEY`.

use super::{DESCRIPTION, Place, Result, StateDictError, bytes_at, checksum, damaged, pickle, places, unsupported};
use std::collections::{BTreeMap, HashMap};
use std::io::{Read, Seek};

/// Signature of an entry, and so of the file.
pub(super) const LOCAL: &[u8] = b"PK\x03\x04";
const CENTRAL: &[u8] = b"PK\x01\x02";
const END: &[u8] = b"PK\x05\x06";
const END_64: &[u8] = b"PK\x06\x06";
const LOCATOR_64: &[u8] = b"PK\x06\x07";
/// Lengths of these records, without names and comments.
const LOCAL_LENGTH: usize = 30;
const CENTRAL_LENGTH: usize = 46;
const END_LENGTH: usize = 22;
const END_64_LENGTH: usize = 56;
const LOCATOR_64_LENGTH: usize = 20;
/// Maximum length of the comment after the end record.
const COMMENT: usize = u16::MAX as usize;

/// The position of a stored entry's bytes.
#[derive(Clone, Copy, Debug)]
struct Entry {
    at: u64,
    length: u64,
    crc: u32,
}

/// The tensors of an archive of `length` bytes.
pub(super) fn tensors(file: &mut (impl Read + Seek), length: u64) -> Result<BTreeMap<String, Place>> {
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

fn u16_at(bytes: &[u8], at: usize) -> usize {
    u16::from_le_bytes([bytes[at], bytes[at + 1]]).into()
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from(u32_at(bytes, at)) | (u64::from(u32_at(bytes, at + 4)) << 32)
}

/// Reads a range that may lie outside the file.
fn range(file: &mut (impl Read + Seek), length: u64, at: u64, count: u64) -> Result<Vec<u8>> {
    if at.checked_add(count).is_none_or(|end| end > length) {
        return Err(cut());
    }
    bytes_at(file, at, count)
}

/// All entries by name, each within the file.
fn directory(file: &mut (impl Read + Seek), length: u64) -> Result<HashMap<String, Entry>> {
    let tail_at = length.saturating_sub((LOCATOR_64_LENGTH + END_LENGTH + COMMENT) as u64);
    let tail = range(file, length, tail_at, length - tail_at)?;
    let last = tail.len().checked_sub(END_LENGTH).ok_or_else(cut)?;
    let end = (0..=last).rev().find(|i| tail[*i..].starts_with(END)).ok_or_else(cut)?;
    let locator = end.checked_sub(LOCATOR_64_LENGTH).map(|i| &tail[i..end]);
    let (size, at) = match locator.filter(|l| l.starts_with(LOCATOR_64)) {
        Some(locator) => {
            let record = range(file, length, u64_at(locator, 8), END_64_LENGTH as u64)?;
            if !record.starts_with(END_64) {
                return Err(cut());
            }
            (u64_at(&record, 40), u64_at(&record, 48))
        }
        None => (u32_at(&tail, end + 12).into(), u32_at(&tail, end + 16).into()),
    };
    if size > DESCRIPTION as u64 {
        return unsupported(format!("a zip archive with a directory of {size} bytes"));
    }
    let records = range(file, length, at, size)?;
    let mut rest = records.as_slice();
    let mut entries = HashMap::new();
    while !rest.is_empty() {
        if rest.len() < CENTRAL_LENGTH || !rest.starts_with(CENTRAL) {
            return Err(cut());
        }
        let name_end = CENTRAL_LENGTH + u16_at(rest, 28);
        let extra_end = name_end + u16_at(rest, 30);
        let record_end = extra_end + u16_at(rest, 32);
        if record_end > rest.len() {
            return Err(cut());
        }
        let name = String::from_utf8_lossy(&rest[CENTRAL_LENGTH..name_end]).into_owned();
        let method = u16_at(rest, 10);
        if method != 0 {
            return unsupported(format!(
                "{name} is compressed, which torch.save does not do; unpack and save it uncompressed"
            ));
        }
        let fields = [u32_at(rest, 24), u32_at(rest, 20), u32_at(rest, 42)];
        let [size, packed, local] = widened(fields, &rest[name_end..extra_end])?;
        if size != packed {
            return Err(cut());
        }
        let header = range(file, length, local, LOCAL_LENGTH as u64)?;
        let start = local + (LOCAL_LENGTH + u16_at(&header, 26) + u16_at(&header, 28)) as u64;
        if !header.starts_with(LOCAL) || start.checked_add(size).is_none_or(|end| end > length) {
            return Err(cut());
        }
        entries.insert(name, Entry { at: start, length: size, crc: u32_at(rest, 16) });
        rest = &rest[record_end..];
    }
    Ok(entries)
}

/// The values of a record's fields; those too large for them are taken from its extra fields.
fn widened(fields: [u32; 3], mut extra: &[u8]) -> Result<[u64; 3]> {
    const WIDE: usize = 1;
    let mut wide: &[u8] = &[];
    while extra.len() >= 4 {
        let end = 4 + u16_at(extra, 2);
        let field = extra.get(4..end).ok_or_else(cut)?;
        if u16_at(extra, 0) == WIDE {
            wide = field;
        }
        extra = &extra[end..];
    }
    let mut all = [0; 3];
    for (value, field) in all.iter_mut().zip(fields) {
        *value = field.into();
        if field == u32::MAX {
            let (first, rest) = wide.split_first_chunk::<8>().ok_or_else(cut)?;
            *value = u64::from_le_bytes(*first);
            wide = rest;
        }
    }
    Ok(all)
}
