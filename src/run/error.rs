//! Errors of operations on a run.

use crate::data::DataError;
use crate::files::{LockError, ReplaceError};
use crate::user_error::UserError;
use std::fmt::Display;

/// Why an operation on a run failed. The messages name the file or the request, and what to do about it.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The user can fix it: the request does not match the run, or one of its files is damaged or missing.
    #[error("{0}")]
    Input(String),
    /// The system refused, or the program is at fault.
    #[error("{0}")]
    Failure(String),
    /// Another process is writing to the run, or the lock cannot be taken.
    #[error(transparent)]
    Lock(#[from] LockError),
    /// The dataset cannot be used.
    #[error(transparent)]
    Data(#[from] DataError),
    /// Something that may not be replaced is where results go, or they cannot be written.
    #[error(transparent)]
    Replace(#[from] ReplaceError),
}

impl RunError {
    /// Creates a [`RunError::Input`] with this message.
    pub fn input(error: impl Display) -> Self {
        Self::Input(error.to_string())
    }

    /// Creates a [`RunError::Failure`] with this message.
    pub fn failure(error: impl Display) -> Self {
        Self::Failure(error.to_string())
    }
}

impl UserError for RunError {
    fn is_input(&self) -> bool {
        match self {
            Self::Input(_) => true,
            Self::Failure(_) => false,
            Self::Lock(error) => error.is_input(),
            Self::Data(error) => error.is_input(),
            Self::Replace(error) => error.is_input(),
        }
    }
}
