//! Models of burn modules as one safetensors file: parameters by name, and the other data needed for drawing as JSON in
//! its header.

use burn::module::Module;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::path::Path;
use volseggs_base::versioned;
use volseggs_core::model::params::{self, FitError, HostTensor};
use volseggs_core::model::scene_file::{SceneError, read_tensors, refuse_not_finite, write_tensors};

/// A file that has been read: its header and its parameters.
pub(super) struct ModelFile<S> {
    /// The data that are not tensors.
    pub spec: S,
    /// Parameters by name.
    pub tensors: BTreeMap<String, HostTensor>,
}

/// The error for a file with unexpected contents.
pub(super) fn wrong(path: &Path, reason: impl Into<String>) -> SceneError {
    SceneError::Format { path: path.into(), reason: reason.into() }
}

/// Writes parameters and a `spec`; `method` is the name of the header entry.
pub(super) fn save(
    path: &Path,
    method: &str,
    tensors: &BTreeMap<String, HostTensor>,
    spec: &impl Serialize,
) -> Result<(), SceneError> {
    let spec = versioned::to_json(spec).map_err(|e| wrong(path, e.to_string()))?;
    write_tensors(path, tensors, Some((method, spec)))
}

/// Reads what [`save`] wrote.
///
/// # Errors
/// If the file is missing or damaged, belongs to another method, or holds a NaN or an infinity.
pub(super) fn read<S: DeserializeOwned>(path: &Path, method: &str) -> Result<ModelFile<S>, SceneError> {
    let (tensors, header) = read_tensors(path)?;
    refuse_not_finite(path, &tensors)?;
    let text = header.get(method);
    let text =
        text.ok_or_else(|| wrong(path, format!("no `{method}` entry in its header: it is of another method")))?;
    let spec = versioned::from_json(text).map_err(|e| wrong(path, format!("header: {e}")))?;
    Ok(ModelFile { spec, tensors })
}

impl<S> ModelFile<S> {
    /// Rejects a header that implies a number of parameters other than the file holds, before any is allocated.
    pub fn check_size(&self, path: &Path, parameters: u128) -> Result<(), SceneError> {
        let held: u128 = self.tensors.values().map(|tensor| tensor.values.len() as u128).sum();
        if parameters == held {
            return Ok(());
        }
        Err(wrong(path, format!("header: the model has {parameters} parameters, the file holds {held}")))
    }

    /// Returns `module` with the file's parameters.
    pub fn fill<M: Module>(&self, path: &Path, module: M) -> Result<M, SceneError> {
        let fit = |source: FitError| SceneError::Fit { path: path.into(), source };
        params::load(module, &self.tensors).map_err(fit)
    }
}
