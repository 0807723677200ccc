//! Errors of a sweep before and outside its runs. A run that fails is not an error: it is recorded.

use crate::user_error::UserError;
use std::path::{Path, PathBuf};

/// Why a sweep cannot be planned, run or read.
#[derive(Debug, thiserror::Error)]
pub enum SweepError {
    /// The sweep file as a whole.
    #[error("{}: {problem}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// One of its keys.
    #[error("{}: {key}: {problem}", path.display())]
    Key {
        /// The file.
        path: PathBuf,
        /// The key, or the variant.
        key: String,
        /// What is wrong, and what would be right.
        problem: String,
    },
    /// The file system.
    #[error("{}: {reason}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        reason: String,
    },
    /// The sweep was stopped; the same command continues it.
    #[error("interrupted; run the same command again to resume")]
    Interrupted,
    /// An input that cannot be used, such as a dataset that does not fit into memory.
    #[error("{0}")]
    Choice(String),
}

impl UserError for SweepError {
    fn is_input(&self) -> bool {
        !matches!(self, Self::Io { .. } | Self::Interrupted)
    }
}

impl SweepError {
    /// An error of the file system at `path`.
    pub fn io(path: &Path, error: impl std::fmt::Display) -> Self {
        Self::Io { path: path.to_owned(), reason: error.to_string() }
    }
}
