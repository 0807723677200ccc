//! Small TOML or JSON files that lie beside a volume and supply what it does not hold itself.

use crate::files::read_settings;
use crate::volume::error::VolumeError;
use crate::words::plain;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};

/// The sidecar of a raw file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawSidecar {
    /// Voxels along x, y, z, or x, y, z and steps.
    pub dims: Vec<u64>,
    /// Scalar type by name.
    #[serde(rename = "type")]
    pub scalar: String,
    /// `little` (default) or `big`.
    pub endian: Option<String>,
    /// Distance between voxels along x, y, z.
    pub spacing: Option<[f64; 3]>,
    /// Centre of the first voxel.
    pub origin: Option<[f64; 3]>,
    /// Bytes before the first value.
    pub offset: Option<u64>,
    /// Time steps in each file.
    pub steps: Option<u64>,
}

/// The sidecar of a file that lacks only its placement.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlaceSidecar {
    /// Distance between voxels along x, y, z.
    pub spacing: Option<[f64; 3]>,
    /// Centre of the first voxel.
    pub origin: Option<[f64; 3]>,
}

/// The one file of `candidates` that exists, if any.
///
/// # Errors
/// Two exist.
pub fn only(path: &Path, candidates: &[PathBuf]) -> Result<Option<PathBuf>, VolumeError> {
    let mut found = candidates.iter().filter(|c| c.is_file());
    let first = found.next();
    if let (Some(a), Some(b)) = (first, found.next()) {
        let problem = format!("both {} and {} exist", a.display(), b.display());
        return Err(VolumeError::invalid(path, "sidecar", problem, "keep one of them"));
    }
    Ok(first.cloned())
}

/// Adds `suffix` to the whole file name: `a.raw` and `.toml` give `a.raw.toml`.
pub fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    PathBuf::from(name)
}

/// Reads a sidecar: JSON where the name ends so, else TOML.
///
/// # Errors
/// Unreadable, too long, not TOML or JSON, an unknown field, or a wrong type.
pub fn read<T: DeserializeOwned>(path: &Path) -> Result<T, VolumeError> {
    let text = read_settings(path)
        .map_err(|e| VolumeError::io(path, "read the sidecar", e, "it should be a text of a few lines"))?;
    let json = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"));
    let parsed = if json {
        serde_json::from_str(&text).map_err(|e| plain(&e.to_string()))
    } else {
        crate::nesting::check_toml(&text).and_then(|()| {
            toml::from_str(&text).map_err(|e: toml::de::Error| {
                let line = e.span().map(|s| 1 + text.bytes().take(s.start).filter(|&b| b == b'\n').count());
                let message = plain(e.message());
                line.map_or_else(|| message.clone(), |n| format!("line {n}: {message}"))
            })
        })
    };
    parsed.map_err(|problem| {
        let hint = "the fields are dims, type, endian, spacing, origin, offset, steps (for .npy only spacing, origin)";
        VolumeError::invalid(path, "sidecar", problem, hint)
    })
}
