//! Reads named tensors from the formats in which networks are published: PyTorch state dicts in both containers of
//! `torch.save`, and safetensors.
//!
//! Implemented here because a state dict needs only two dozen pickle instructions: the crate that reads them
//! (`pytorch-reader`) depends on tar and zip, changes the inflate implementation of the whole program, and sets no
//! bounds suited to files this small. The directory of a zip archive is read by `rawzip`. Nothing in a file is executed. Only its description is held in memory (at most
//! [`DESCRIPTION`] bytes); values are read one tensor at a time, and each size is checked against the file before
//! anything is allocated.

mod legacy;
mod pickle;
#[cfg(test)]
mod tests;
mod torch;
mod zip;

use burn::tensor::f16;
use safetensors::Dtype;
use safetensors::tensor::Metadata;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;
use torch::TorchTensor;

/// Maximum size in bytes of the description of the tensors (pickles, a directory, a header). Published networks need 10
/// kB.
const DESCRIPTION: usize = 1 << 20;

/// Offset and value of the magic number of a tar archive, the format in which torchvision's first networks were
/// published.
const TAR: (usize, &[u8]) = (257, b"ustar");

/// Why a file yields no tensors. The messages follow the file's name.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StateDictError {
    /// The system cannot read the file.
    #[error("cannot be read: {0}")]
    Io(#[from] io::Error),
    /// The file has no known format.
    #[error("neither a PyTorch file (.pth) nor safetensors; it may be an error page: download it again")]
    Unknown,
    /// The file is truncated or inconsistent.
    #[error("damaged: {0}; download it again")]
    Damaged(String),
    /// The file holds something that does not occur in a state dict of weights.
    #[error("not a state dict of weights: {0}")]
    Unsupported(String),
    /// A tensor is missing.
    #[error("there is no tensor `{0}`")]
    Missing(String),
    /// A tensor has the wrong shape.
    #[error("`{key}` has shape {found:?}, expected {expected:?}")]
    Shape {
        /// The tensor.
        key: String,
        /// The expected shape.
        expected: Vec<usize>,
        /// The shape in the file.
        found: Vec<usize>,
    },
    /// A tensor holds NaN or infinity.
    #[error("`{0}` holds values that are not finite; download the file again")]
    NotFinite(String),
}

type Result<T> = std::result::Result<T, StateDictError>;

fn damaged<T>(what: impl Into<String>) -> Result<T> {
    Err(StateDictError::Damaged(what.into()))
}

fn unsupported<T>(what: impl Into<String>) -> Result<T> {
    Err(StateDictError::Unsupported(what.into()))
}

/// The storage type of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum StorageKind {
    Single,
    Half,
}

impl StorageKind {
    fn size(self) -> u64 {
        match self {
            Self::Single => 4,
            Self::Half => 2,
        }
    }
}

/// The location of a tensor in the file. Its bytes are within the file.
#[derive(Clone, Debug)]
struct TensorLocation {
    kind: StorageKind,
    shape: Vec<usize>,
    at: u64,
    /// The checksum of these bytes, if the file has one for exactly this range.
    crc: Option<u32>,
}

/// The tensors of a file by name, read on demand.
#[derive(Debug)]
pub(super) struct StateDict<F> {
    file: F,
    tensors: BTreeMap<String, TensorLocation>,
}

impl StateDict<File> {
    /// Opens a file, recognising its format by its content.
    pub(super) fn open(path: &Path) -> Result<Self> {
        // a pipe or a device has no end, and opening a pipe waits for a writer
        if !std::fs::metadata(path)?.is_file() {
            return Err(io::Error::other("not a regular file").into());
        }
        Self::read(File::open(path)?)
    }
}

impl<F: Read + Seek> StateDict<F> {
    fn read(mut file: F) -> Result<Self> {
        let length = file.seek(SeekFrom::End(0))?;
        let head = bytes_at(&mut file, 0, length.min(DESCRIPTION as u64))?;
        let tensors = if head.starts_with(zip::LOCAL) {
            zip::tensors(&mut file, length)?
        } else if head.starts_with(legacy::MAGIC) {
            legacy::tensors(&mut file, &head, length)?
        } else if head.get(8) == Some(&b'{') {
            safetensors(&head, length)?
        } else if head.get(TAR.0..).is_some_and(|h| h.starts_with(TAR.1)) {
            return unsupported("it has the container format of PyTorch before 0.1.10; use the file published now");
        } else {
            return Err(StateDictError::Unknown);
        };
        Ok(Self { file, tensors })
    }

    /// The shape of a tensor, if there is one of that name.
    pub(super) fn shape(&self, key: &str) -> Option<&[usize]> {
        self.tensors.get(key).map(|t| t.shape.as_slice())
    }

    /// The finite values of a tensor of the given shape, in row-major order.
    pub(super) fn values(&mut self, key: &str, shape: &[usize]) -> Result<Vec<f32>> {
        let place = self.tensors.get(key).ok_or_else(|| StateDictError::Missing(key.into()))?;
        if place.shape != shape {
            let (expected, found) = (shape.to_vec(), place.shape.clone());
            return Err(StateDictError::Shape { key: key.into(), expected, found });
        }
        let count =
            elements(shape).ok_or_else(|| StateDictError::Damaged(format!("the size of `{key}` is invalid")))?;
        let bytes = bytes_at(&mut self.file, place.at, count * place.kind.size())?;
        if place.crc.is_some_and(|crc| crc != checksum(&bytes)) {
            return damaged(format!("the checksum of `{key}` is wrong"));
        }
        let values: Vec<f32> = match place.kind {
            StorageKind::Single => bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect(),
            StorageKind::Half => bytes.as_chunks().0.iter().map(|b| f16::from_le_bytes(*b).to_f32()).collect(),
        };
        if !values.iter().all(|v| v.is_finite()) {
            return Err(StateDictError::NotFinite(key.into()));
        }
        Ok(values)
    }
}

/// The number of elements of a shape, if it is small enough for its bytes to be counted.
fn elements(shape: &[usize]) -> Option<u64> {
    let count = shape.iter().try_fold(1u64, |n, side| n.checked_mul(*side as u64))?;
    (count < 1 << 60).then_some(count)
}

/// Reads a range that is known to lie within the file.
fn bytes_at(file: &mut (impl Read + Seek), at: u64, length: u64) -> Result<Vec<u8>> {
    file.seek(SeekFrom::Start(at))?;
    let mut bytes = vec![0; length as usize];
    file.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn checksum(bytes: &[u8]) -> u32 {
    let mut crc = flate2::Crc::new();
    crc.update(bytes);
    crc.sum()
}

/// Locates the tensors of a pickle in their storages; `storage` returns a storage's position, length in bytes and
/// checksum.
fn places<'a>(
    tensors: BTreeMap<String, TorchTensor<'a>>,
    storage: impl Fn(&TorchTensor<'a>) -> Result<(u64, u64, Option<u32>)>,
) -> Result<BTreeMap<String, TensorLocation>> {
    let place = |(key, tensor): (String, TorchTensor<'a>)| {
        let (start, length, crc) = storage(&tensor)?;
        let size = tensor.kind.size();
        if length != tensor.storage.count * size {
            return damaged(format!(
                "`{key}` is described with {} values but stored with a different number",
                tensor.storage.count
            ));
        }
        let whole = elements(&tensor.shape) == Some(tensor.storage.count);
        // the pickle reader has checked that the tensor lies within the storage
        let at = start + tensor.offset * size;
        Ok((key, TensorLocation { kind: tensor.kind, shape: tensor.shape, at, crc: crc.filter(|_| whole) }))
    };
    tensors.into_iter().map(place).collect()
}

/// The tensors of a safetensors file; types other than F32 and F16 are omitted.
fn safetensors(head: &[u8], length: u64) -> Result<BTreeMap<String, TensorLocation>> {
    const PREFIX: usize = 8;
    let cut = || StateDictError::Damaged("its header is longer than the file, or than 1 MiB".into());
    let (size, rest) = head.split_first_chunk::<PREFIX>().ok_or_else(cut)?;
    let size = usize::try_from(u64::from_le_bytes(*size)).map_err(|_| cut())?;
    let header = rest.get(..size).ok_or_else(cut)?;
    let header: Metadata =
        serde_json::from_slice(header).map_err(|e| StateDictError::Damaged(format!("its header: {e}")))?;
    let data = (PREFIX + size) as u64;
    let mut places = BTreeMap::new();
    for (key, info) in header.tensors() {
        let (start, end) = (info.data_offsets.0 as u64, info.data_offsets.1 as u64);
        let outside = || damaged(format!("`{key}` does not lie within the file"));
        if end > length - data {
            return outside();
        }
        let kind = match info.dtype {
            Dtype::F32 => StorageKind::Single,
            Dtype::F16 => StorageKind::Half,
            _ => continue,
        };
        if end.checked_sub(start) != elements(&info.shape).map(|n| n * kind.size()) {
            return outside();
        }
        places.insert(key, TensorLocation { kind, shape: info.shape.clone(), at: data + start, crc: None });
    }
    Ok(places)
}
