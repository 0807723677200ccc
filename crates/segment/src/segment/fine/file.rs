//! File format of a trained affinity field in a run folder, with the data needed to evaluate it.

use super::network::{AffinityField, PositionBox};
use crate::model::params;
use crate::model::scene_file::{SceneError, read_tensors, refuse_not_finite, write_tensors};
use crate::versioned;
use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Key of the entry in the file's header.
const ENTRY: &str = "volseggs.affinity";

/// Metadata that the tensors do not contain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AffinitySpec {
    /// The box that its positions are measured in.
    pub frame: PositionBox,
    /// Time of the Gaussians that it was trained on, in [0, 1].
    pub time: f64,
    /// Fingerprint of the scene.
    pub scene: String,
    /// Spreads of the masks, scene units, ascending: scale `s` is the spread at index `s * (len - 1)`.
    pub spreads: Vec<f32>,
}

/// Writes a field, atomically.
///
/// # Errors
/// If the file cannot be written.
pub fn save(path: &Path, field: &AffinityField, spec: &AffinitySpec) -> Result<(), SceneError> {
    let text = versioned::to_json(spec).map_err(|e| SceneError::Format { path: path.into(), reason: e.to_string() })?;
    write_tensors(path, &params::collect(field), Some((ENTRY, text)))
}

/// Reads a field written by [`save`].
///
/// # Errors
/// If the file is missing, damaged or holds another network.
pub fn load(path: &Path, device: &Device) -> Result<(AffinityField, AffinitySpec), SceneError> {
    let (tensors, header) = read_tensors(path)?;
    refuse_not_finite(path, &tensors)?;
    let format = |reason: String| SceneError::Format { path: path.into(), reason };
    let text =
        header.get(ENTRY).ok_or_else(|| format(format!("no `{ENTRY}` entry in its header: not an affinity field")))?;
    let spec = versioned::from_json(text).map_err(|e| format(format!("header: {e}")))?;
    let field = params::load(AffinityField::new(0, device), &tensors)
        .map_err(|source| SceneError::Fit { path: path.into(), source })?;
    Ok((field, spec))
}
