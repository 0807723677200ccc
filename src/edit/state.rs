//! Checks of the Gaussians that edits change, and what a hidden one is. What an edit does is in `apply`.

use super::error::EditError;
use crate::model::HostGaussians;

/// The opacity logit of a hidden Gaussian: its sigmoid is 0 in single precision, yet it is finite for files.
pub const HIDDEN_LOGIT: f32 = -100.0;

/// Checks that the arrays agree about N and K.
///
/// # Errors
/// [`EditError::Shape`] or [`EditError::ShStride`]. Values are not looked at: what is not finite stays so.
pub(super) fn check(gaussians: &HostGaussians) -> Result<(), EditError> {
    if !matches!(gaussians.sh_stride, 1 | 4 | 9 | 16) {
        return Err(EditError::ShStride { found: gaussians.sh_stride });
    }
    match gaussians.misshapen() {
        Some((column, expected)) => Err(EditError::Shape { field: column.name, expected, found: column.values.len() }),
        None => Ok(()),
    }
}
