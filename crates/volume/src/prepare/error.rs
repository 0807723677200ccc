//! Why a dataset could not be made.

use crate::data::DataError;
use crate::files::ReplaceError;
use crate::memory::TooLarge;
use crate::volume::error::VolumeError;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a dataset could not be made.
#[derive(Debug, Error)]
pub enum PrepareError {
    /// A volume, label volume or transfer function cannot be used.
    #[error(transparent)]
    Volume(#[from] VolumeError),
    /// The dataset cannot be written.
    #[error(transparent)]
    Data(#[from] DataError),
    /// Something other than a dataset is at its place.
    #[error(transparent)]
    Replace(#[from] ReplaceError),
    /// The options do not fit the data.
    #[error("{0}")]
    Options(String),
    /// Something is at the place of the dataset, and is not to be replaced.
    #[error("{}: already exists; choose another name", .0.display())]
    Exists(PathBuf),
    /// It does not fit into memory.
    #[error(transparent)]
    Memory(#[from] TooLarge),
    /// There would be nothing to train on.
    #[error("every training image is empty, so nothing was written: {}", nothing_visible(source_of_values, transfer, *span, *size))]
    Empty {
        /// What was rendered.
        source_of_values: String,
        /// Name of the transfer function.
        transfer: String,
        /// Data values at its two ends.
        span: [f64; 2],
        /// Sides of the volume in its own units.
        size: [f64; 3],
    },
    /// A file system error.
    #[error("{}: {reason}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        reason: String,
    },
    /// Stopped from outside; nothing was left behind.
    #[error("interrupted; nothing was written")]
    Interrupted,
}

/// Ratio of the longest to the shortest side from which a volume is so thin that this explains empty images.
const THIN: f64 = 100.0;

/// Why no image shows anything: the shape of the volume, or else the transfer function.
pub(super) fn nothing_visible(source: &str, transfer: &str, [low, high]: [f64; 2], size: [f64; 3]) -> String {
    let (longest, shortest) = (size.into_iter().fold(0.0, f64::max), size.into_iter().fold(f64::INFINITY, f64::min));
    if longest > THIN * shortest {
        let [x, y, z] = size;
        return format!(
            "the volume {source} is {x} x {y} x {z} in size, so thin that there is next to nothing to see, as opacity \
             accrues by length; correct its spacing"
        );
    }
    format!(
        "the transfer function {transfer} (over the values {low} to {high}) makes nothing visible in {source}; compare its \
         opacities with the histogram: volseggs inspect VOLUME --transfer-function TF --picture histogram.png"
    )
}

impl PrepareError {
    /// Names the dataset `out` in place of the temporary folder `root` in which it was made, and each path once.
    pub(super) fn published_as(self, root: &Path, out: &Path) -> Self {
        let (path, reason) = match self {
            Self::Write { path, reason } => (path, reason),
            Self::Data(DataError::Io { path, action, source, hint }) if path.starts_with(root) => {
                (path, format!("cannot {action}: {source}. Hint: {hint}"))
            }
            other => return other,
        };
        let named = |text: String| text.replace(&*root.to_string_lossy(), &out.to_string_lossy());
        let mut reason = named(reason);
        let name = named(path.display().to_string());
        while let Some(rest) = reason.strip_prefix(&format!("{name}: ")) {
            reason = rest.to_owned();
        }
        Self::Write { path: name.into(), reason }
    }
}
