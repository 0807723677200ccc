//! What can go wrong with a Segment Anything network. Messages only.

use super::MaskError;
use super::checkpoint::{CONVERT, FILE_NAME, SOURCE};
use std::path::PathBuf;

fn list(paths: &[PathBuf]) -> String {
    paths.iter().map(|p| p.display().to_string()).collect::<Vec<_>>().join(", ")
}

/// Why a network cannot be loaded or an image cannot be segmented.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SamError {
    /// There is no weights file.
    #[error(
        "no MobileSAM checkpoint; looked for {looked}. Give one with --sam-weights PATH or put {FILE_NAME} there. \
         Make it from the published {SOURCE} with: {CONVERT}",
        looked = list(looked)
    )]
    NoCheckpoint {
        /// The files that were looked for.
        looked: Vec<PathBuf>,
    },
    /// The weights file cannot be read.
    #[error("cannot read the SAM weights {path}: {source}", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The weights file is not a complete safetensors file.
    #[error(
        "{path} is not a complete safetensors file ({source}); copy it again, or convert the published {SOURCE} \
         with: {CONVERT}",
        path = path.display()
    )]
    Format {
        /// The file.
        path: PathBuf,
        /// The error of the parser.
        source: safetensors::SafeTensorError,
    },
    /// A tensor is absent.
    #[error("{path}: the tensor `{tensor}` is missing; use a file of MobileSAM (vit_t) weights", path = path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// The tensor.
        tensor: String,
    },
    /// A tensor has the wrong shape.
    #[error(
        "{path}: `{tensor}` has shape {found:?}, expected {expected:?}; use a file of MobileSAM (vit_t) weights",
        path = path.display()
    )]
    Shape {
        /// The file.
        path: PathBuf,
        /// The tensor.
        tensor: String,
        /// The shape the network asks for.
        expected: Vec<usize>,
        /// The shape in the file.
        found: Vec<usize>,
    },
    /// A tensor has an unsupported element type.
    #[error("{path}: `{tensor}` holds {found} values; convert them to F32 or F16", path = path.display())]
    Type {
        /// The file.
        path: PathBuf,
        /// The tensor.
        tensor: String,
        /// The element type in the file.
        found: String,
    },
    /// A tensor holds NaN or infinity, or a variance below zero.
    #[error("{path}: `{tensor}` holds values that are not finite or not allowed; copy the weights again", path = path.display())]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// The tensor.
        tensor: String,
    },
    /// Dimensions that do not fit each other.
    #[error("SAM configuration, {field}: {rule}")]
    Config {
        /// The field.
        field: &'static str,
        /// The rule that it breaks.
        rule: String,
    },
    /// An image buffer of the wrong length.
    #[error("the image holds {found} bytes, expected {height} * {width} * 3; give RGB bytes without alpha")]
    ImageSize {
        /// Width in pixels.
        width: usize,
        /// Height in pixels.
        height: usize,
        /// Bytes given.
        found: usize,
    },
    /// An empty image, or one so thin that resizing would leave nothing of it.
    #[error(
        "an image of {width}x{height} pixels cannot be resized to a longest side of {side}; \
         give a larger or less elongated one"
    )]
    ImageShape {
        /// Width in pixels.
        width: usize,
        /// Height in pixels.
        height: usize,
        /// The network's input side.
        side: usize,
    },
    /// A prompt that cannot be encoded.
    #[error("SAM prompt {index}: {rule}")]
    Prompt {
        /// Which of the batch, from 0.
        index: usize,
        /// What is wrong.
        rule: &'static str,
    },
    /// An option of the automatic mode is 0.
    #[error("automatic masks, {field}: must be above 0")]
    Option {
        /// The option.
        field: &'static str,
    },
    /// A mask that cannot be stored.
    #[error(transparent)]
    Mask(#[from] MaskError),
    /// The result cannot be read from the device.
    #[error("cannot read the SAM result from the device: {0}")]
    Device(String),
}
