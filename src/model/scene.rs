//! A scene: what training makes and everything after reads. Gaussians, their field, and where they lie.

use super::extra_encoder::ExtraEncoder;
use super::gaussians::HostGaussians;
use super::params::{self, FitError, HostTensor};
use super::{DeformationField, Deformed, Gaussians};
use crate::config::types::{EncoderKind, ModelConfig};
use crate::tensors::{self, DIGEST, TensorFileError};
use burn::module::Module;
use burn::tensor::{Device, Int, Tensor};
use safetensors::tensor::{Dtype, TensorView};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use volseggs_kernels::Camera;
use volseggs_kernels::splat::{SplatInputs, SplatSettings, splat};

/// What cannot be read off the tensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneSpec {
    /// The model's configuration.
    pub model: ModelConfig,
    /// Centre of the field's box, world units.
    pub centre: [f32; 3],
    /// Half sides of the field's box, world units.
    pub half_size: [f32; 3],
    /// Background colour of the training images.
    pub background: [f32; 3],
    /// Whether the field has been trained; before that the canonical Gaussians are drawn at every time.
    pub deformed: bool,
    /// Spherical-harmonics degree in use.
    pub sh_degree: usize,
}

/// Gaussians and their deformation.
#[derive(Module, Debug)]
pub struct Scene {
    /// Canonical Gaussians.
    pub gaussians: Gaussians,
    /// How they change over time.
    pub field: DeformationField,
    /// Everything else.
    #[module(skip)]
    pub spec: SceneSpec,
}

/// Why a scene file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The file cannot be read or written, or is damaged.
    #[error(transparent)]
    File(#[from] TensorFileError),
    /// The file is not what it should be.
    #[error("{path}: {reason}")]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A number that is none.
    #[error(
        "{path}: tensor {tensor}, row {row}: {value} is no finite number; the scene is spoilt, go back to an older checkpoint or \
         train again"
    )]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// The tensor.
        tensor: String,
        /// Its row, from 0; a Gaussian for tensors called `gaussians.*`.
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

/// A rendered view on a device.
#[derive(Debug)]
pub struct View {
    /// Colour over the background and alpha `[H, W, 4]`.
    pub image: Tensor<3>,
    /// Radii on screen `[N]`, 0 for Gaussians not drawn.
    pub radii: Tensor<1, Int>,
}

impl Scene {
    /// A scene from canonical Gaussians, with a new field.
    pub fn new(gaussians: HostGaussians, spec: SceneSpec, seed: u64, device: &Device) -> Self {
        let field = DeformationField::new(&spec.model, spec.centre, spec.half_size, seed, device);
        Self { gaussians: Gaussians::from_host(gaussians, device), field, spec }
    }

    /// The Gaussians at `time` in [0, 1].
    pub fn at(&self, time: f32) -> Deformed {
        self.at_without(time, None)
    }

    /// The Gaussians at `time`, those that are `asleep` `[N]` left out: they come out transparent.
    pub fn at_without(&self, time: f32, asleep: Option<&[bool]>) -> Deformed {
        if !self.spec.deformed {
            return Deformed::canonical(&self.gaussians);
        }
        self.field.deform(&self.gaussians, time, asleep)
    }

    /// Draws Gaussians that are already at their time.
    pub fn draw(&self, at: Deformed, camera: Camera, background: [f32; 3], offsets: Option<Tensor<2>>) -> View {
        let inputs = SplatInputs {
            means: at.means,
            rotations: at.rotations,
            log_scales: at.log_scales,
            opacity_logits: at.opacity_logits,
            sh: self.gaussians.sh.val(),
            screen_offsets: offsets,
        };
        let out = splat(inputs, SplatSettings { camera, background, sh_degree: self.spec.sh_degree });
        View { image: out.image, radii: out.radii }
    }

    /// Renders `[H, W, 4]` (colour over the scene's background, and alpha) to the host.
    pub fn render(&self, camera: Camera, time: f32) -> Vec<f32> {
        params::to_vec(self.draw(self.at(time), camera, self.spec.background, None).image)
    }

    /// 16 hexadecimal digits that tell this state of the scene from others: a 64-bit FNV-1a hash of the canonical means,
    /// in their order.
    pub fn fingerprint(&self) -> String {
        let means = params::to_vec(self.gaussians.means.val());
        let bytes = means.iter().flat_map(|v| v.to_le_bytes());
        let hash = bytes.fold(0xcbf2_9ce4_8422_2325u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
        format!("{hash:016x}")
    }

    /// Writes the scene as one safetensors file, its spec in the header.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), SceneError> {
        let spec = serde_json::to_string(&self.spec)
            .map_err(|e| SceneError::Format { path: path.into(), reason: e.to_string() })?;
        write_tensors(path, &params::collect(self), Some(("volseggs", spec)))
    }

    /// Reads what [`Scene::save`] wrote.
    ///
    /// # Errors
    /// If the file is missing, damaged or does not fit its own spec, holds a NaN or an infinity, or was trained with an encoder that is not
    /// registered in this program.
    pub fn load(path: &Path, device: &Device) -> Result<Self, SceneError> {
        let (tensors, metadata) = read_tensors(path)?;
        refuse_not_finite(path, &tensors)?;
        let format = |reason: String| SceneError::Format { path: path.into(), reason };
        let spec =
            metadata.get("volseggs").ok_or_else(|| format("no `volseggs` entry in its header: not a scene".into()))?;
        let spec: SceneSpec = serde_json::from_str(spec).map_err(|e| format(format!("header: {e}")))?;
        if spec.model.encoder == EncoderKind::Extra {
            ExtraEncoder::check(&spec.model).map_err(|e| format(e.to_string()))?;
        }
        let k = (spec.model.sh_degree + 1).pow(2);
        let empty = HostGaussians {
            sh: vec![0.0; 3 * k],
            means: vec![0.0; 3],
            rotations: vec![0.0; 4],
            log_scales: vec![0.0; 3],
            opacity_logits: vec![0.0],
        };
        let scene = Self::new(empty, spec, 0, device);
        let scene = params::load(scene, &tensors).map_err(|source| SceneError::Fit { path: path.into(), source })?;
        let g = &scene.gaussians;
        let n = g.count();
        if [g.rotations.dims()[0], g.log_scales.dims()[0], g.opacity_logits.dims()[0], g.sh.dims()[0]] != [n; 4] {
            return Err(format("the Gaussians' tensors differ in length".into()));
        }
        Ok(scene)
    }
}

/// Writes named tensors as safetensors with one entry of the header and a digest, atomically.
///
/// # Errors
/// If the file cannot be written.
pub fn write_tensors(
    path: &Path,
    tensors: &BTreeMap<String, HostTensor>,
    metadata: Option<(&str, String)>,
) -> Result<(), SceneError> {
    let bytes: Vec<(&String, Vec<u8>, &Vec<usize>)> = tensors
        .iter()
        .map(|(name, t)| (name, t.values.iter().flat_map(|v| v.to_le_bytes()).collect(), &t.shape))
        .collect();
    let format = |reason: String| SceneError::Format { path: path.into(), reason };
    let views = bytes
        .iter()
        .map(|(name, data, shape)| Ok((name.as_str(), TensorView::new(Dtype::F32, (*shape).clone(), data)?)))
        .collect::<Result<Vec<_>, safetensors::SafeTensorError>>()
        .map_err(|e| format(e.to_string()))?;
    Ok(tensors::write(path, views, metadata)?)
}

/// Named f32 tensors and the strings of the header.
pub type TensorFile = (BTreeMap<String, HostTensor>, BTreeMap<String, String>);

/// Reads what [`write_tensors`] wrote.
///
/// # Errors
/// If the file is missing, damaged or holds anything but f32.
pub fn read_tensors(path: &Path) -> Result<TensorFile, SceneError> {
    let bytes = tensors::read(path)?;
    let format = |reason: String| SceneError::Format { path: path.into(), reason };
    let damaged = |e: safetensors::SafeTensorError| format(format!("damaged or not a safetensors file: {e}"));
    let (_, header) = safetensors::SafeTensors::read_metadata(&bytes).map_err(damaged)?;
    let file = safetensors::SafeTensors::deserialize(&bytes).map_err(damaged)?;
    let mut tensors = BTreeMap::new();
    for (name, view) in file.tensors() {
        if name == DIGEST {
            continue;
        }
        if view.dtype() != Dtype::F32 {
            return Err(format(format!("tensor {name} is {:?}, expected F32", view.dtype())));
        }
        let values = view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        tensors.insert(name, HostTensor { shape: view.shape().to_vec(), values });
    }
    let metadata = header.metadata().clone().unwrap_or_default().into_iter().collect();
    Ok((tensors, metadata))
}

/// Names the first value that is no finite number.
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
