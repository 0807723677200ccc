//! Why a client's request is refused.

use crate::run::RunError;

/// Why a change is refused.
#[derive(Debug, thiserror::Error)]
pub enum ChangeError {
    /// The document has been changed meanwhile.
    #[error("segments or edits were changed meanwhile; review them and try again")]
    Stale,
    /// The document is of an older checkpoint.
    #[error("a newer checkpoint of the run is being read; try again in a moment")]
    Reading,
    /// Nothing may be changed.
    #[error("this viewer was started with --read-only")]
    ReadOnly,
    /// The scene is still being trained.
    #[error("this run is being trained here; make segments and edits once that has ended, in `volseggs view`")]
    InTraining,
    /// There is nothing to pause.
    #[error("no training is running in this viewer")]
    NoTraining,
    /// It cannot be done.
    #[error(transparent)]
    Run(#[from] RunError),
}
