//! Writers (and readers) of files for other programs, and the table of those that `volseggs export` writes.
//!
//! A built-in format is a file here with its writer and its [`Exporter`], and a line in [`EXPORTERS`]; a program adds its
//! own by `volseggs::extend`.

pub mod animation;
pub mod exporters;
pub mod exr;
pub mod fields;
pub mod images;
pub mod labels;
pub mod npy;
mod nrrd;
pub mod ply;
pub mod splat_file;
pub mod spz;
pub mod video;
mod vti;

use crate::registry::Registry;
use exporters::{Exporter, NPY, NRRD, VTI};

/// All formats, by extension. The first is that of a folder whose format is not given.
pub static EXPORTERS: Registry<Exporter> = Registry::new(
    "format",
    &[("ply", &ply::EXPORTER), ("spz", &spz::EXPORTER), ("nrrd", &NRRD), ("vti", &VTI), ("npy", &NPY)],
);
