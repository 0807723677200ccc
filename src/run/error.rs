//! Why something cannot be done with a run.

use crate::data::DataError;
use crate::files::{LockError, ReplaceError};
use std::fmt::Display;

/// Why something cannot be done with a run. The texts name the file or what was asked for, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// Whoever asked can mend it: what was asked for does not fit the run, or a file of it is damaged or missing.
    #[error("{0}")]
    Input(String),
    /// The system refused, or the program is at fault.
    #[error("{0}")]
    Failure(String),
    /// Another process writes into the run, or the lock cannot be taken.
    #[error(transparent)]
    Lock(#[from] LockError),
    /// The dataset.
    #[error(transparent)]
    Data(#[from] DataError),
    /// Something stands where results go that may not be replaced, or they cannot be written.
    #[error(transparent)]
    Replace(#[from] ReplaceError),
}

impl RunError {
    /// [`RunError::Input`] with this text.
    pub fn input(error: impl Display) -> Self {
        Self::Input(error.to_string())
    }

    /// [`RunError::Failure`] with this text.
    pub fn failure(error: impl Display) -> Self {
        Self::Failure(error.to_string())
    }

    /// Whether whoever asked can mend it.
    #[must_use]
    pub fn is_input(&self) -> bool {
        match self {
            Self::Input(_) | Self::Lock(LockError::Held { .. }) => true,
            Self::Failure(_) | Self::Lock(LockError::Io { .. }) => false,
            Self::Data(error) => error.is_input(),
            Self::Replace(error) => error.is_input(),
        }
    }
}
