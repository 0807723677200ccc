//! The container of `torch.save` up to PyTorch 1.5: pickles (magic number, protocol, system, state dict, storage keys),
//! then each storage as a count and its values.

use super::pickle::{self, Pickle};
use super::{Result, TensorLocation, bytes_at, damaged, places, unsupported};
use std::collections::{BTreeMap, HashMap};
use std::io::{Read, Seek};

/// The pickle of the magic number.
pub(super) const MAGIC: &[u8] = b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19.";
/// Size in bytes of the count before a storage.
const COUNT: u64 = 8;

/// The tensors of a file of `length` bytes that starts with `head`.
pub(super) fn tensors(
    file: &mut (impl Read + Seek),
    head: &[u8],
    length: u64,
) -> Result<BTreeMap<String, TensorLocation>> {
    let mut at = MAGIC.len();
    let mut next = || -> Result<Pickle<'_>> {
        let pickle = pickle::read(&head[at..])?;
        at += pickle.length;
        Ok(pickle)
    };
    let _protocol = next()?;
    if next()?.flag("little_endian") != Some(true) {
        return unsupported("it was not written on a little-endian machine");
    }
    let tensors = next()?.tensors();
    let Some(keys) = next()?.texts() else { return damaged("the keys of its storages are invalid") };
    let described: HashMap<&str, (u64, u64)> =
        tensors.values().map(|t| (t.storage.key, (t.storage.count, t.kind.size()))).collect();
    let mut storages = HashMap::new();
    let mut at = at as u64;
    for key in keys {
        // without a tensor the element size is unknown, and so is the position of the next storage
        let Some((count, size)) = described.get(key) else { return damaged(format!("storage {key} is not described")) };
        let (start, bytes) = (at + COUNT, count * size);
        if start > length || bytes > length - start {
            return damaged(format!("it ends at byte {length}, before the end of storage {key}"));
        }
        let stored = bytes_at(file, at, COUNT)?;
        if stored != count.to_le_bytes() {
            return damaged(format!("the size of storage {key} is wrong"));
        }
        storages.insert(key, (start, bytes));
        at = start + bytes;
    }
    places(tensors, |tensor| match storages.get(tensor.storage.key) {
        Some((start, bytes)) => Ok((*start, *bytes, None)),
        None => damaged(format!("storage {} is missing", tensor.storage.key)),
    })
}
