//! Readers of volume files, chosen by extension. Each returns a [`VolumeFile`] that holds no open file between reads.

mod common;
pub mod decode;
pub mod nifti;
pub mod npy;
pub mod nrrd;
pub mod raw;
mod sidecar;
mod stream;
#[cfg(test)]
mod tests;
pub mod vti;

use crate::volume::error::VolumeError;
use crate::volume::source::VolumeFile;
use std::path::Path;

/// The file types that are read, for messages.
pub const READ: &str = ".nrrd, .nhdr, .npy, .vti, .nii, .nii.gz, and .raw/.bin/.dat with a sidecar";

/// A file format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Plain values, described by a sidecar.
    Raw,
    /// NumPy array.
    Npy,
    /// Nearly Raw Raster Data.
    Nrrd,
    /// VTK image data.
    Vti,
    /// NIfTI.
    Nifti,
}

/// The format of a file by its name, and the length of its extension in bytes with the dot; case does not matter.
#[must_use]
pub fn format_of(path: &Path) -> Option<(Format, usize)> {
    const KNOWN: [(&str, Format); 9] = [
        (".nii.gz", Format::Nifti),
        (".nii", Format::Nifti),
        (".vti", Format::Vti),
        (".nrrd", Format::Nrrd),
        (".nhdr", Format::Nrrd),
        (".npy", Format::Npy),
        (".raw", Format::Raw),
        (".bin", Format::Raw),
        (".dat", Format::Raw),
    ];
    let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
    KNOWN.iter().find(|(e, _)| name.len() > e.len() && name.ends_with(e)).map(|(e, f)| (*f, e.len()))
}

/// Opens a volume file: reads its header, not its values.
///
/// # Errors
/// A missing file, an unknown extension, or an error of the format's reader.
pub fn open(path: &Path) -> Result<Box<dyn VolumeFile>, VolumeError> {
    match format_of(path) {
        Some((Format::Raw, _)) => raw::open(path),
        Some((Format::Npy, _)) => npy::open(path),
        Some((Format::Nrrd, _)) => nrrd::open(path),
        Some((Format::Vti, _)) => vti::open(path),
        Some((Format::Nifti, _)) => nifti::open(path),
        None if !path.exists() => Err(VolumeError::invalid(
            path,
            "file",
            "does not exist",
            "name volume files, a folder, or a pattern in quotes",
        )),
        None => Err(VolumeError::invalid(
            path,
            "extension",
            "is not that of a supported volume format",
            format!("supported are {READ}"),
        )),
    }
}
