//! Errors of training.

use crate::data::error::DataError;
use crate::log::jsonl::JsonlError;
use crate::user_error::UserError;
use std::path::{Path, PathBuf};

/// Why training stops.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// Training cannot start with the data.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A number is not finite.
    #[error(
        "step {step}: {what} is not finite (NaN or infinite); nothing after the last checkpoint was kept. \
         Train into another --out with a lower learning rate of that group, or another seed"
    )]
    NotFinite {
        /// Global step, from 0.
        step: usize,
        /// The loss, or the tensor with the element.
        what: String,
    },
    /// The configuration contradicts itself.
    #[error("configuration: {0}")]
    Config(String),
    /// Another process writes into the run.
    #[error(transparent)]
    Lock(#[from] crate::files::LockError),
    /// The metrics file cannot be used.
    #[error(transparent)]
    Metrics(#[from] JsonlError),
    /// There is nothing to resume from, or it does not fit.
    #[error(transparent)]
    Resume(super::checkpoint::CheckpointError),
    /// A checkpoint cannot be written.
    #[error(transparent)]
    Save(super::checkpoint::CheckpointError),
    /// A log cannot be written.
    #[error("{path}: {reason}")]
    Log {
        /// The file.
        path: PathBuf,
        /// What happened.
        reason: String,
    },
}

impl UserError for TrainError {
    fn is_input(&self) -> bool {
        match self {
            Self::Data(error) => error.is_input(),
            Self::Lock(error) => error.is_input(),
            Self::Config(_) | Self::Resume(_) | Self::Metrics(JsonlError::Line { .. }) => true,
            Self::NotFinite { .. } | Self::Log { .. } | Self::Metrics(_) | Self::Save(_) => false,
        }
    }
}

impl TrainError {
    /// Returns a function that makes this error of one about the log at `path`.
    pub(super) fn in_file<E: std::fmt::Display>(path: &Path) -> impl FnOnce(E) -> Self {
        move |e| Self::Log { path: path.into(), reason: e.to_string() }
    }
}
