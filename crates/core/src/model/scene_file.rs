//! The file format of a scene, and files of named f32 tensors, which checkpoints and affinity fields use too.

use super::d3dgs;
use super::host::HostGaussians;
use super::packed::{self, StoredTensor};
use super::params::{self, FitError, HostTensor};
use super::size::{self, check_model};
use super::{Scene, SceneSpec};
use crate::tensors::{self, DIGEST, TensorFileError};
use crate::versioned;
use burn::tensor::Device;
use safetensors::tensor::TensorView;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Why a scene file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The file cannot be read or written, or is damaged.
    #[error(transparent)]
    File(#[from] TensorFileError),
    /// The content of the file is not as expected.
    #[error("{path}: {reason}")]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A value is not finite.
    #[error(
        "{path}: tensor {tensor}, row {row}: {value} is not finite; the scene is damaged: use an older checkpoint or \
         train again"
    )]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// The tensor.
        tensor: String,
        /// Its row, from 0; a Gaussian for tensors named `gaussians.*`.
        row: usize,
        /// The value.
        value: f32,
    },
    /// Its tensors do not fit.
    #[error("{path}: {source}")]
    Fit {
        /// The file.
        path: PathBuf,
        /// What does not fit.
        source: FitError,
    },
}

impl SceneError {
    /// Whether the bytes are not those that were written, or hold non-finite values: another copy of the file, or an
    /// older checkpoint, helps.
    pub fn is_damage(&self) -> bool {
        matches!(self, Self::NotFinite { .. } | Self::File(TensorFileError::Damaged { .. }))
    }
}

impl Scene {
    /// Writes the scene as one safetensors file, its spec in the header.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), SceneError> {
        let spec = versioned::to_json(&self.spec)
            .map_err(|e| SceneError::Format { path: path.into(), reason: e.to_string() })?;
        write_tensors(path, &params::collect(self), Some(("volseggs", spec)))
    }

    /// Writes the scene in 8 and 16 bits, as described in `model/packed.rs`, with the fingerprint of this one.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save_packed(&self, path: &Path) -> Result<(), SceneError> {
        let spec = SceneSpec { packed_from: Some(self.fingerprint()), ..self.spec.clone() };
        let spec =
            versioned::to_json(&spec).map_err(|e| SceneError::Format { path: path.into(), reason: e.to_string() })?;
        write_stored(path, &packed::pack(&params::collect(self)), Some(("volseggs", spec)))
    }

    /// Reads what [`Scene::save`] or [`Scene::save_packed`] wrote.
    ///
    /// # Errors
    /// If the file is missing, damaged or does not fit its own spec, holds a NaN or an infinity, or was trained with an
    /// encoder not registered in this program.
    pub fn load(path: &Path, device: &Device) -> Result<Self, SceneError> {
        let (tensors, metadata) = read_tensors(path)?;
        refuse_not_finite(path, &tensors)?;
        let format = |reason: String| SceneError::Format { path: path.into(), reason };
        let spec =
            metadata.get("volseggs").ok_or_else(|| format("no `volseggs` entry in its header: not a scene".into()))?;
        let spec: SceneSpec = versioned::from_json(spec).map_err(|e| format(format!("header: {e}")))?;
        check_spec(&spec, &tensors).map_err(|e| format(format!("header: {e}")))?;
        refuse_empty(&tensors).map_err(&format)?;
        let one = HostGaussians::one(&spec.model);
        let scene = Self::from_tensors(spec, &tensors, device)
            .map_err(|source| SceneError::Fit { path: path.into(), source })?;
        let n = scene.gaussians.count();
        let rows = |name: &str| tensors.get(&format!("gaussians.{name}")).and_then(|t| t.shape.first().copied());
        if one.columns().any(|column| rows(column.name) != Some(n)) {
            return Err(format("the Gaussians' tensors differ in length".into()));
        }
        Ok(scene)
    }
}

/// Rejects a spec that no scene has, or that asks for a larger field than the file holds: the field is allocated from
/// the spec before the tensors are loaded.
fn check_spec(spec: &SceneSpec, tensors: &BTreeMap<String, HostTensor>) -> Result<(), String> {
    check_model(&spec.model)?;
    if spec.sh_degree > spec.model.sh_degree {
        return Err(format!("sh_degree = {} is above model.sh_degree = {}", spec.sh_degree, spec.model.sh_degree));
    }
    let box_of = spec.centre.iter().chain(&spec.half_size).chain(&spec.background);
    if !box_of.copied().all(f32::is_finite) || spec.half_size.iter().any(|h| *h <= 0.0) {
        return Err("centre, half_size and background must be finite, half_size above 0".into());
    }
    let of_field = tensors.iter().filter(|(name, _)| name.starts_with("field."));
    let held: u128 = of_field.map(|(_, tensor)| tensor.values.len() as u128).sum();
    let asked = match &spec.d3dgs {
        Some(network) => {
            if spec.model.embedding > 0 {
                return Err("D3DGS has no model.embedding".into());
            }
            d3dgs::check(network)?;
            d3dgs::parameters(network)
        }
        None => size::field_parameters(&spec.model),
    };
    if asked > held {
        return Err(format!("the model needs a field of {asked} values, but the file holds {held}"));
    }
    Ok(())
}

/// Rejects a scene without Gaussians: not every backend can hold an empty tensor.
fn refuse_empty(tensors: &BTreeMap<String, HostTensor>) -> Result<(), String> {
    let empty = |(name, tensor): (&String, &HostTensor)| name.starts_with("gaussians.") && tensor.values.is_empty();
    if tensors.iter().any(empty) { Err("holds no Gaussians".to_owned()) } else { Ok(()) }
}

/// Writes named tensors as safetensors with an optional header entry and a digest, atomically.
///
/// # Errors
/// If the file cannot be written.
pub fn write_tensors(
    path: &Path,
    tensors: &BTreeMap<String, HostTensor>,
    metadata: Option<(&str, String)>,
) -> Result<(), SceneError> {
    let all: Vec<StoredTensor> = tensors.iter().map(|(name, tensor)| StoredTensor::full(name, tensor)).collect();
    write_stored(path, &all, metadata)
}

fn write_stored(path: &Path, all: &[StoredTensor], metadata: Option<(&str, String)>) -> Result<(), SceneError> {
    let views = all
        .iter()
        .map(|tensor| Ok((tensor.name.as_str(), tensor.view()?)))
        .collect::<Result<Vec<_>, safetensors::SafeTensorError>>()
        .map_err(|e| SceneError::Format { path: path.into(), reason: e.to_string() })?;
    Ok(tensors::write(path, views, metadata)?)
}

/// Named f32 tensors and the strings of the header.
pub type TensorFile = (BTreeMap<String, HostTensor>, BTreeMap<String, String>);

/// Reads what [`write_tensors`] wrote.
///
/// # Errors
/// If the file is missing, damaged, or holds types other than f32 and those of packed scenes.
pub fn read_tensors(path: &Path) -> Result<TensorFile, SceneError> {
    tensors::read_while(path, |bytes| parse(path, bytes))?
}

fn parse(path: &Path, bytes: &[u8]) -> Result<TensorFile, SceneError> {
    let format = |reason: String| SceneError::Format { path: path.into(), reason };
    let damaged = |e: safetensors::SafeTensorError| format(format!("damaged or not a safetensors file: {e}"));
    let (_, header) = safetensors::SafeTensors::read_metadata(bytes).map_err(damaged)?;
    let file = safetensors::SafeTensors::deserialize(bytes).map_err(damaged)?;
    let mut tensors = BTreeMap::new();
    let all = file.tensors();
    let ranges: BTreeMap<&str, &TensorView<'_>> =
        all.iter().filter_map(|(name, view)| Some((name.strip_suffix(packed::RANGE)?, view))).collect();
    for (name, view) in &all {
        if name == DIGEST || name.ends_with(packed::RANGE) {
            continue;
        }
        let values = packed::unpack(view, ranges.get(name.as_str()).copied())
            .map_err(|reason| format(format!("tensor {name} {reason}")))?;
        let name = name.clone();
        tensors.insert(name, HostTensor { shape: view.shape().to_vec(), values });
    }
    let metadata = header.metadata().clone().unwrap_or_default().into_iter().collect();
    Ok((tensors, metadata))
}

/// Rejects non-finite values, naming the first.
///
/// # Errors
/// [`SceneError::NotFinite`].
pub fn refuse_not_finite(path: &Path, tensors: &BTreeMap<String, HostTensor>) -> Result<(), SceneError> {
    for (name, tensor) in tensors {
        if let Some(at) = tensor.values.iter().position(|v| !v.is_finite()) {
            let row = at / tensor.shape.iter().skip(1).product::<usize>().max(1);
            return Err(SceneError::NotFinite {
                path: path.into(),
                tensor: name.clone(),
                row,
                value: tensor.values[at],
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::fixture::{scene, scene_of};
    use super::*;
    use crate::device::DeviceName;
    use crate::versioned::Versioned;

    #[test]
    fn a_header_states_every_key_of_its_model() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scene.safetensors");
        let good = scene();
        let mut spec = serde_json::to_value(Versioned::new(&good.spec)).unwrap();
        spec["model"].as_object_mut().unwrap().remove("dilation").unwrap();
        write_tensors(&path, &params::collect(&good), Some(("volseggs", spec.to_string()))).unwrap();
        let error = Scene::load(&path, &DeviceName::all()[0].open().unwrap()).unwrap_err().to_string();
        assert!(error.contains("scene.safetensors") && error.contains("`dilation`"), "{error}");
    }

    #[test]
    fn a_header_that_asks_for_more_than_the_file_holds_is_refused_before_it_is_allocated() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scene.safetensors");
        let device = DeviceName::all()[0].open().unwrap();
        let good = scene();
        good.save(&path).unwrap();
        assert_eq!(Scene::load(&path, &device).unwrap().gaussians.count(), 2);
        type Edit = fn(&mut SceneSpec);
        let cases: [(Edit, &str); 7] = [
            (|s| s.model.resolution = 20_000, "the file holds"),
            (|s| s.model.levels = usize::MAX, "the file holds"),
            (|s| s.model.width = 1_000_000, "the file holds"),
            (|s| s.model.channels = 0, "model.channels = 0"),
            (|s| s.model.sh_degree = usize::MAX, "0, 2 or 4"),
            (|s| s.sh_degree = 3, "above model.sh_degree"),
            (|s| s.half_size[1] = 0.0, "half_size above 0"),
        ];
        for (edit, words) in cases {
            let mut spec = good.spec.clone();
            edit(&mut spec);
            let text = versioned::to_json(&spec).unwrap();
            write_tensors(&path, &params::collect(&good), Some(("volseggs", text))).unwrap();
            let error = Scene::load(&path, &device).unwrap_err().to_string();
            assert!(error.contains(words) && error.contains("scene.safetensors"), "{error}");
        }
    }

    #[test]
    fn the_implicit_encoder_is_saved_and_read() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scene.safetensors");
        let device = DeviceName::all()[0].open().unwrap();
        let scene = scene_of("implicit");
        scene.save(&path).unwrap();
        let read = Scene::load(&path, &device).unwrap();
        assert_eq!((params::collect(&read), &read.spec), (params::collect(&scene), &scene.spec));
        let means = |scene: &Scene| params::to_vec(scene.deformed(0.3).means);
        assert_eq!(means(&read), means(&scene));
    }

    #[test]
    fn a_scene_without_gaussians_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scene.safetensors");
        let good = scene();
        let mut tensors = params::collect(&good);
        for (_, tensor) in tensors.iter_mut().filter(|(name, _)| name.starts_with("gaussians.")) {
            tensor.shape[0] = 0;
            tensor.values.clear();
        }
        let text = versioned::to_json(&good.spec).unwrap();
        write_tensors(&path, &tensors, Some(("volseggs", text))).unwrap();
        let device = DeviceName::all()[0].open().unwrap();
        assert!(Scene::load(&path, &device).unwrap_err().to_string().contains("holds no Gaussians"));
    }
}
