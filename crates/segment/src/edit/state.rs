//! Checks of the Gaussians that edits change, and the opacity of hidden ones. What an edit does is in `apply`.

use super::error::EditError;
use crate::model::HostGaussians;
use volseggs_kernels::sh::Bands;

/// Opacity logit of a hidden Gaussian: its sigmoid is 0 in single precision, but it is finite for files.
pub const HIDDEN_LOGIT: f32 = -100.0;

/// Checks that the arrays agree on N and K.
///
/// # Errors
/// [`EditError::Shape`] or [`EditError::ShStride`]. Values are not checked: non-finite ones stay so.
pub(super) fn check(gaussians: &HostGaussians) -> Result<(), EditError> {
    if Bands::from_count(gaussians.sh_stride).is_none() {
        return Err(EditError::ShStride { found: gaussians.sh_stride });
    }
    match gaussians.mismatched_column() {
        Some((column, expected)) => Err(EditError::Shape { field: column.name, expected, found: column.values.len() }),
        None => Ok(()),
    }
}
