//! What a format that `volseggs export` writes says of itself, and those of voxels. The table is in the module above.
//!
//! A format is a description with functions and no trait, since nothing about a format has a state. Pictures, films and
//! numbers of pixels are not here: `volseggs render` makes them, of cameras and not of a scene.

use super::EXPORTERS;
use super::fields::{self, FieldVolume};
use super::labels::{self, LabelVolume, LabelsError};
use super::splat_file::{SplatFileError, SplatFileOptions};
use crate::files::ReplaceError;
use crate::model::HostGaussians;
use serde::de::Error;
use serde::{Deserialize, Deserializer};
use std::ops::RangeInclusive;
use std::path::Path;

/// A format of files for other programs.
#[derive(Clone, Debug)]
pub struct Exporter {
    /// Extension of the files, in lower case.
    pub extension: &'static str,
    /// Longer endings that mean something to readers; each ends in the extension.
    pub endings: &'static [&'static str],
    /// What it is, for help texts.
    pub description: &'static str,
    /// What its files hold, and how they are written.
    pub content: Content,
}

/// What files of a format hold, and how they are written. Writers should refuse to replace what is not the program's own,
/// as `files::write_named` does.
#[derive(Clone, Debug)]
pub enum Content {
    /// Gaussians.
    Gaussians {
        /// Writes Gaussians, at least one, whose rotations have length 1.
        write: GaussianWriter,
        /// Natural logarithms of the standard deviations that the files can hold.
        log_scales: RangeInclusive<f32>,
        /// Whether the files may hold harmonics of a higher degree than the Gaussians have.
        has_sh_degree: bool,
    },
    /// Labels, fields or either on voxels.
    Voxels {
        /// Writes labels, if the files hold them.
        labels: Option<LabelWriter>,
        /// Writes fields, if the files hold them.
        fields: Option<FieldWriter>,
        /// Whether the files state what the axes of space mean.
        states_space: bool,
    },
}

/// Writes Gaussians into a file.
pub type GaussianWriter = fn(&HostGaussians, &Path, &SplatFileOptions) -> Result<(), SplatFileError>;

/// Writes labels into a file.
pub type LabelWriter = fn(&Path, &LabelVolume<'_>) -> Result<(), LabelsError>;

/// Writes fields into a file.
pub type FieldWriter = fn(&Path, &FieldVolume<'_>) -> Result<(), ReplaceError>;

/// What all is known of the voxels is in its header.
pub(super) const NRRD: Exporter = Exporter {
    extension: "nrrd",
    endings: &["seg.nrrd"],
    description: "Labels of segments or fields on voxels, for 3D Slicer and others",
    content: Content::Voxels { labels: Some(labels::write_nrrd), fields: Some(fields::write_nrrd), states_space: true },
};

/// VTK image data.
pub(super) const VTI: Exporter = Exporter {
    extension: "vti",
    endings: &[],
    description: "Labels of segments or fields on voxels, for VTK and ParaView",
    content: Content::Voxels { labels: Some(labels::write_vti), fields: Some(fields::write_vti), states_space: false },
};

/// Arrays of numbers, without the names of labels.
pub(super) const NPY: Exporter = Exporter {
    extension: "npy",
    endings: &[],
    description: "Fields on voxels, for NumPy",
    content: Content::Voxels { labels: None, fields: Some(fields::write_npy), states_space: false },
};

impl Exporter {
    /// Returns all exporters.
    pub fn all() -> Vec<&'static Self> {
        EXPORTERS.all().into_iter().map(|(_, exporter)| exporter).collect()
    }

    /// Returns the exporter of files with this extension, in any case.
    pub fn of_extension(extension: &str) -> Option<&'static Self> {
        EXPORTERS.get(&extension.to_ascii_lowercase()).ok()
    }

    /// Whether it writes Gaussians.
    pub fn holds_gaussians(&self) -> bool {
        matches!(self.content, Content::Gaussians { .. })
    }

    /// How it writes labels, if it does.
    pub fn labels(&self) -> Option<LabelWriter> {
        match self.content {
            Content::Gaussians { .. } => None,
            Content::Voxels { labels, .. } => labels,
        }
    }
}

impl PartialEq for Exporter {
    fn eq(&self, other: &Self) -> bool {
        self.extension == other.extension
    }
}

/// Reads an exporter from the extension of its files.
///
/// # Errors
/// If there is none.
pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<&'static Exporter, D::Error> {
    EXPORTERS.get(&String::deserialize(deserializer)?).map_err(D::Error::custom)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_format_is_found_by_its_extension_alone() {
        let extensions: Vec<&str> = Exporter::all().iter().map(|exporter| exporter.extension).collect();
        assert_eq!(extensions, ["ply", "spz", "nrrd", "vti", "npy"]);
        assert_eq!(extensions, EXPORTERS.names());
        for extension in extensions {
            let exporter = Exporter::of_extension(&extension.to_uppercase()).unwrap();
            assert_eq!(exporter.extension, extension);
            assert!(!exporter.description.is_empty());
            assert!(exporter.endings.iter().all(|ending| ending.ends_with(&format!(".{extension}"))));
        }
        let read = |text: &str| deserialize(&mut serde_json::Deserializer::from_str(text));
        assert_eq!(read("\"spz\"").unwrap().extension, "spz");
        assert!(read("\"obj\"").unwrap_err().to_string().contains("no format \"obj\"; available: ply, spz, nrrd"));
    }
}
