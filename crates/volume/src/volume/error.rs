//! What can be wrong with a volume, a transfer function or their files: what, where, and how to fix it.

use crate::user_error::UserError;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A volume, series or transfer function that cannot be used.
#[derive(Debug, Error)]
pub enum VolumeError {
    /// The file system reported an error.
    #[error("{}: cannot {action}: {source}; {hint}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was attempted: "open the file".
        action: &'static str,
        /// The file system's error.
        source: std::io::Error,
        /// What to do.
        hint: String,
    },
    /// The content is invalid.
    #[error("{}: {field}: {problem}; {hint}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// The field, line or voxel.
        field: String,
        /// What is wrong.
        problem: String,
        /// What to do.
        hint: String,
    },
}

impl UserError for VolumeError {
    fn is_input(&self) -> bool {
        match self {
            Self::Io { source, .. } => crate::files::is_user_error(source),
            Self::Invalid { .. } => true,
        }
    }
}

impl VolumeError {
    /// An error of the file system.
    pub fn io(path: &Path, action: &'static str, source: std::io::Error, hint: impl Into<String>) -> Self {
        Self::Io { path: path.to_owned(), action, source, hint: hint.into() }
    }

    /// An error of the content.
    pub fn invalid(path: &Path, field: impl Into<String>, problem: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::Invalid { path: path.to_owned(), field: field.into(), problem: problem.into(), hint: hint.into() }
    }
}
