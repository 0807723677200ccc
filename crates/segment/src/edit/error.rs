//! Errors of edits. Every message says what is wrong, where, and how to fix it.

use crate::versioned::OtherFormat;
use std::path::PathBuf;

/// An error of reading, checking or applying edits.
#[derive(Debug, thiserror::Error)]
pub enum EditError {
    /// A file could not be read or written.
    #[error("{}: cannot {action}: {source}; check the path and the permissions", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was attempted.
        action: &'static str,
        /// Why it failed.
        source: std::io::Error,
    },
    /// The file is not JSON.
    #[error("{}: not valid JSON: {source}; correct the file or restore an older copy", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// Where and why parsing stopped.
        source: serde_json::Error,
    },
    /// A field of the file is missing, unknown or wrong.
    #[error("{}: {field}: {problem}", path.display())]
    Field {
        /// The file.
        path: PathBuf,
        /// The field, as in `operations[2].operation.rotate.axis`; operations count from 0 here, as in JSON.
        field: String,
        /// What is wrong and how to fix it.
        problem: String,
    },
    /// The file is of another version.
    #[error("{}: {source}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// Which version it states.
        source: OtherFormat,
    },
    /// A value of an edit cannot be used.
    #[error("{field}: {problem}")]
    Value {
        /// The field of the edit, as in `operation.scale.factor`.
        field: String,
        /// What is wrong and how to fix it.
        problem: String,
    },
    /// An edit names a segment that does not exist.
    #[error("edit {edit}: there is no segment \"{name}\"; correct the name, or remove the edit")]
    UnknownSegment {
        /// Number of the edit in the list, from 1.
        edit: usize,
        /// The name.
        name: String,
    },
    /// A segment contains a Gaussian that does not exist.
    #[error("segment \"{name}\": Gaussian {index} of {count} does not exist; segment this scene again")]
    Index {
        /// The segment.
        name: String,
        /// The index.
        index: u32,
        /// Number of Gaussians.
        count: usize,
    },
    /// The arrays of the Gaussians are inconsistent.
    #[error("{field}: {found} values where {expected} are needed; give every array the same number of Gaussians")]
    Shape {
        /// The array.
        field: &'static str,
        /// Values needed.
        expected: usize,
        /// Values found.
        found: usize,
    },
    /// Not a valid number of spherical-harmonics coefficients.
    #[error("sh_stride: {found} coefficients; give 1, 4, 9 or 16 (degree 0 to 3), or 6 or 15 (even bands)")]
    ShStride {
        /// Coefficients per Gaussian.
        found: usize,
    },
}
