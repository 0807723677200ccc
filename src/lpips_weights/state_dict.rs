//! Reads named tensors from the formats in which networks are published: PyTorch state dicts in both containers of
//! `torch.save`, by `pytorch-reader`, and safetensors. Nothing in a file is executed,
//! but one made to do harm can take far more memory than its size: the reader copies what a pickle repeats.

#[cfg(test)]
mod tests;

use crate::files::{open_regular, read_regular};
use crate::tensors::floats;
use pytorch_reader::{DType, PickleError, PytorchError, PytorchReader};
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, Metadata, TensorView};
use std::io::{self, ErrorKind, Read};
use std::path::Path;

/// First bytes of a zip archive, the container of PyTorch since 1.6.
const ZIP: &[u8] = b"PK\x03\x04";
/// First bytes of the container before: the pickle of a magic number.
const LEGACY: &[u8] = b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19.";
/// Offset and value of the magic number of a tar archive, the format in which torchvision's first networks were
/// published. Refused, as the reader would hold all of it, and as much as a sparse entry claims.
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

/// The tensors of a file by name.
#[derive(Debug)]
pub(super) enum StateDict {
    /// Values are read on demand.
    Torch(PytorchReader),
    /// The header, and the bytes after it.
    Safetensors(Metadata, Vec<u8>),
}

impl StateDict {
    /// Opens a file, recognising its format by its content.
    pub(super) fn open(path: &Path) -> Result<Self> {
        let mut head = Vec::new();
        open_regular(path)?.take((TAR.0 + TAR.1.len()) as u64).read_to_end(&mut head)?;
        if head.starts_with(ZIP) || head.starts_with(LEGACY) {
            return Ok(Self::Torch(PytorchReader::new(path).map_err(refusal)?));
        }
        if head.get(8) == Some(&b'{') {
            let mut bytes = read_regular(path)?;
            let (size, header) = SafeTensors::read_metadata(&bytes).map_err(|e| damaged(&e))?;
            bytes.drain(..size_of::<u64>() + size);
            return Ok(Self::Safetensors(header, bytes));
        }
        if head.get(TAR.0..) == Some(TAR.1) {
            let what = "it has the container format of PyTorch before 0.1.10; use the file published now";
            return Err(StateDictError::Unsupported(what.into()));
        }
        Err(StateDictError::Unknown)
    }

    /// The shape of a tensor, if there is one of that name.
    pub(super) fn shape(&self, key: &str) -> Option<&[usize]> {
        match self {
            Self::Torch(file) => file.get(key).map(|t| t.shape()),
            Self::Safetensors(header, _) => header.info(key).map(|t| t.shape.as_slice()),
        }
    }

    /// The finite values of a tensor of the given shape, in row-major order.
    pub(super) fn values(&self, key: &str, shape: &[usize]) -> Result<Vec<f32>> {
        let missing = || StateDictError::Missing(key.into());
        let found = self.shape(key).ok_or_else(missing)?;
        if found != shape {
            let (expected, found) = (shape.to_vec(), found.to_vec());
            return Err(StateDictError::Shape { key: key.into(), expected, found });
        }
        let other = |kind: &dyn std::fmt::Debug| {
            StateDictError::Unsupported(format!("`{key}` holds {kind:?} values, not F32 or F16"))
        };
        let read;
        let (kind, bytes) = match self {
            Self::Torch(file) => {
                let tensor = file.get(key).ok_or_else(missing)?;
                let kind = match tensor.dtype() {
                    DType::F32 => Dtype::F32,
                    DType::F16 => Dtype::F16,
                    kind => return Err(other(&kind)),
                };
                read = tensor.read().map_err(unreadable)?;
                (kind, read.as_slice())
            }
            Self::Safetensors(header, data) => {
                let info = header.info(key).ok_or_else(missing)?;
                (info.dtype, &data[info.data_offsets.0..info.data_offsets.1])
            }
        };
        let view = TensorView::new(kind, shape.to_vec(), bytes).map_err(|e| damaged(&e))?;
        let values = floats(&view).ok_or_else(|| other(&kind))?;
        if !values.iter().all(|v| v.is_finite()) {
            return Err(StateDictError::NotFinite(key.into()));
        }
        Ok(values)
    }
}

fn damaged(what: &impl ToString) -> StateDictError {
    StateDictError::Damaged(what.to_string().trim_end_matches('.').into())
}

fn refusal(error: PytorchError) -> StateDictError {
    match error {
        PytorchError::Io(e) | PytorchError::Pickle(PickleError::Io(e)) if e.kind() == ErrorKind::UnexpectedEof => {
            damaged(&"it ends in the middle of its description")
        }
        PytorchError::Io(e) | PytorchError::Pickle(PickleError::Io(e)) => unreadable(e),
        PytorchError::Pickle(e @ (PickleError::UnsupportedType(_) | PickleError::UnsupportedOpCode(_))) => {
            StateDictError::Unsupported(e.to_string().trim_end_matches('.').into())
        }
        PytorchError::InvalidFormat(what) | PytorchError::Pickle(PickleError::InvalidData(what)) => damaged(&what),
        PytorchError::Pickle(e) => damaged(&e),
        other => damaged(&other),
    }
}

/// An error of the system, or else of the content of the file.
fn unreadable(error: io::Error) -> StateDictError {
    match error.raw_os_error() {
        Some(_) => error.into(),
        None => damaged(&error),
    }
}
