//! What can go wrong with a sweep before and beside its runs. A run that fails is no error: it is recorded.

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
        /// What the system said.
        reason: String,
    },
    /// The sweep was stopped; the same command goes on.
    #[error("interrupted; the same command goes on from here")]
    Interrupted,
    /// A choice of runs that chooses none.
    #[error("{0}")]
    Choice(String),
}

impl SweepError {
    /// An error of the file system at `path`.
    pub fn io(path: &Path, error: impl std::fmt::Display) -> Self {
        Self::Io { path: path.to_owned(), reason: error.to_string() }
    }
}
