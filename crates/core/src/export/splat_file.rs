//! Parts shared by the files of Gaussians for other programs.

use super::ply::MAX_SH_DEGREE;
use crate::files::{AtomicFile, ReplaceError};
use crate::model::HostGaussians;
use std::borrow::Cow;
use std::io;
use std::path::{Path, PathBuf};
use volseggs_kernels::sh::Bands;

/// Why a file of Gaussians cannot be written or read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SplatFileError {
    /// The file system failed.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
    /// The content is invalid.
    #[error("{path}: {reason}")]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong and where.
        reason: String,
    },
    /// Something else is where the file should go.
    #[error(transparent)]
    Replace(#[from] ReplaceError),
    /// The fields of the Gaussians are inconsistent.
    #[error("the Gaussians cannot be written: {0}")]
    Shape(String),
}

/// What a file holds besides the Gaussians.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SplatFileOptions {
    /// Degree of the spherical harmonics, at least that of the Gaussians: higher coefficients are 0. Only for formats that
    /// have a choice. The loader of the reference implementation of 3DGS accepts files of degree 3 only.
    pub sh_degree: usize,
    /// What a reader must know of the coordinates and the time, one line each.
    pub comments: Vec<String>,
}

impl Default for SplatFileOptions {
    fn default() -> Self {
        Self { sh_degree: MAX_SH_DEGREE, comments: Vec::new() }
    }
}

/// Returns Gaussians as files hold them: shaded ones, and those with even bands alone, as [`HostGaussians::baked`], since
/// readers support only harmonics of all bands.
///
/// # Errors
/// [`SplatFileError::Shape`] if the fields differ in length.
pub(super) fn plain(gaussians: &HostGaussians) -> Result<Cow<'_, HostGaussians>, SplatFileError> {
    check(gaussians)?;
    let is_plain = gaussians.shading.is_none() && Bands::of_any(gaussians.sh_stride) == Bands::All;
    Ok(if is_plain { Cow::Borrowed(gaussians) } else { Cow::Owned(gaussians.baked()) })
}

/// Writes a file with `body`, atomically; replaces only a file of this program.
pub(super) fn write(path: &Path, body: impl FnOnce(&mut AtomicFile) -> io::Result<()>) -> Result<(), SplatFileError> {
    let mut file = AtomicFile::create_named(path)?;
    body(&mut file)
        .and_then(|()| file.commit())
        .map_err(|source| SplatFileError::Io { path: path.to_path_buf(), source })
}

/// Checks that the fields of the Gaussians are consistent.
fn check(gaussians: &HostGaussians) -> Result<(), SplatFileError> {
    if Bands::from_count(gaussians.sh_stride).is_none() {
        let stride = gaussians.sh_stride;
        return Err(SplatFileError::Shape(format!("sh_stride {stride} is not 1, 4, 9 or 16, nor 6 or 15")));
    }
    let Some((column, wanted)) = gaussians.mismatched_column() else { return Ok(()) };
    Err(SplatFileError::Shape(format!(
        "{} holds {} entries but {} Gaussians of degree {} need {wanted}",
        column.name,
        column.values.len(),
        gaussians.len(),
        gaussians.sh_degree()
    )))
}
