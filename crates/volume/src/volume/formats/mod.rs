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
pub enum VolumeFormat {
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
pub fn format_of(path: &Path) -> Option<(VolumeFormat, usize)> {
    const KNOWN: [(&str, VolumeFormat); 9] = [
        (".nii.gz", VolumeFormat::Nifti),
        (".nii", VolumeFormat::Nifti),
        (".vti", VolumeFormat::Vti),
        (".nrrd", VolumeFormat::Nrrd),
        (".nhdr", VolumeFormat::Nrrd),
        (".npy", VolumeFormat::Npy),
        (".raw", VolumeFormat::Raw),
        (".bin", VolumeFormat::Raw),
        (".dat", VolumeFormat::Raw),
    ];
    let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
    KNOWN.iter().find(|(e, _)| name.len() > e.len() && name.ends_with(e)).map(|(e, f)| (*f, e.len()))
}

/// Formats that are not read, by their extensions, and what to do with such a file.
const NOT_READ: [(&[&str], &str); 9] = [
    (
        &[".hdr", ".img", ".hdr.gz", ".img.gz"],
        "a .hdr/.img pair: convert it to one .nii or .nii.gz file (NIfTI-1), for example with nibabel",
    ),
    (
        &[".npz"],
        "an archive of several arrays: save one of them with numpy.save, as in numpy.save(\"rho.npy\", archive[\"rho\"])",
    ),
    (
        &[".vtk", ".vtr", ".vts", ".vtu", ".pvd", ".pvti", ".pvtr", ".vthb"],
        "save it from ParaView as .vti, after the filter Resample To Image if its grid is not regular",
    ),
    (&[".mha", ".mhd"], "save it as .nrrd, for example with 3D Slicer or SimpleITK"),
    (
        &[".nc", ".nc4", ".h5", ".hdf5", ".hdf", ".zarr", ".mat"],
        "save the field as .npy, for example with xarray or h5py",
    ),
    (&[".dcm", ".ima"], "save the series as .nrrd or .nii.gz, for example with 3D Slicer or dcm2niix"),
    (&[".tif", ".tiff"], "save the stack as .npy, for example with tifffile"),
    (&[".vdb"], "save a dense grid as .npy or .vti"),
    (
        &[".raw.gz", ".npy.gz", ".vti.gz", ".nrrd.gz", ".zip", ".tar", ".gz", ".bz2", ".xz", ".zst", ".7z"],
        "unpack it first; .nii.gz, and .nrrd with its own compression, are read as they are",
    ),
];

/// What to do with a file of a known format that is not read, by its name; `None` for any other.
pub fn not_read(path: &Path) -> Option<&'static str> {
    let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
    let known = |extensions: &[&str]| extensions.iter().any(|e| name.len() > e.len() && name.ends_with(e));
    NOT_READ.iter().find(|(extensions, _)| format_of(path).is_none() && known(extensions)).map(|(_, what)| *what)
}

/// Opens a volume file: reads its header, not its values. If it holds several arrays, the one that it marks as active is
/// read, or the first.
///
/// # Errors
/// A missing file, an unknown extension, or an error of the format's reader.
pub fn open(path: &Path) -> Result<Box<dyn VolumeFile>, VolumeError> {
    open_variable(path, None)
}

/// Like [`open`], with the name of the array to read.
///
/// # Errors
/// As [`open`]; no such array, or a format whose files hold one field.
pub fn open_variable(path: &Path, variable: Option<&str>) -> Result<Box<dyn VolumeFile>, VolumeError> {
    let format = format_of(path).map(|(format, _)| format);
    if let (Some(name), Some(_)) = (variable, format.filter(|f| *f != VolumeFormat::Vti)) {
        let problem = format!("{name:?} is requested, but such files hold one field without a name");
        return Err(VolumeError::invalid(path, "--variable", problem, "omit it; it is for .vti"));
    }
    match format {
        Some(VolumeFormat::Raw) => raw::open(path),
        Some(VolumeFormat::Npy) => npy::open(path),
        Some(VolumeFormat::Nrrd) => nrrd::open(path),
        Some(VolumeFormat::Vti) => vti::open(path, variable),
        Some(VolumeFormat::Nifti) => nifti::open(path),
        None if !path.exists() => Err(VolumeError::invalid(
            path,
            "file",
            "does not exist",
            "name volume files, a folder, or a pattern in quotes",
        )),
        None => {
            let hint = not_read(path).map_or_else(|| format!("supported are {READ}"), str::to_owned);
            Err(VolumeError::invalid(path, "extension", "is not that of a supported volume format", hint))
        }
    }
}
