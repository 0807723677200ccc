//! A scene: the result of training and the input of everything after it. Gaussians, their field, and where they lie.
//! Its file format is in [`super::scene_file`].

use super::host::HostGaussians;
use super::params::{self, FitError, HostTensor};
use super::rendering::Rendering;
use super::{DeformationField, Gaussians};
use crate::config::types::D3dgsConfig;
use crate::config::types::ModelConfig;
use burn::module::Module;
use burn::tensor::{Device, Int, Tensor};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use volseggs_kernels::PinholeCamera;
use volseggs_kernels::splat::{SplatInputs, splat};

/// The properties of a scene that its tensors do not show.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneSpec {
    /// The model's configuration.
    pub model: ModelConfig,
    /// Centre of the field's box, scene units.
    pub centre: [f32; 3],
    /// Half sides of the field's box, scene units.
    pub half_size: [f32; 3],
    /// Background colour of the training images.
    pub background: [f32; 3],
    /// Whether the field has been trained; before that the canonical Gaussians are drawn at every time.
    pub deformed: bool,
    /// Spherical-harmonics degree in use.
    pub sh_degree: usize,
    /// The network of D3DGS, in place of the model's field.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub d3dgs: Option<D3dgsConfig>,
    /// Fingerprint of the scene that was rounded to make this one: both have the same Gaussians in the same order, so
    /// segments of that scene are valid for this one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub packed_from: Option<String>,
}

impl SceneSpec {
    /// Centre of the field's box, scene units: what cameras look at.
    pub fn centre(&self) -> DVec3 {
        DVec3::from_array(self.centre.map(f64::from))
    }

    /// How its Gaussians are drawn.
    pub fn rendering(&self) -> Rendering {
        let Self { background, sh_degree, .. } = *self;
        Rendering { background, sh_degree, ..Rendering::from(&self.model) }
    }
}

/// Gaussians and their deformation.
///
/// ```no_run
/// use std::path::Path;
/// use volseggs_core::device::DeviceName;
/// use volseggs_core::model::Scene;
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let scene = Scene::load(Path::new("scene.safetensors"), &DeviceName::all()[0].open()?)?;
/// let at_half_time = scene.host_at(0.5);
/// println!("{} Gaussians", at_half_time.len());
/// # Ok(())
/// # }
/// ```
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

/// A rendered view on a device.
#[derive(Debug)]
pub struct RenderedView {
    /// Colour over the background and alpha `[H, W, 4]`.
    pub image: Tensor<3>,
    /// Radii on screen `[N]`, 0 for Gaussians not drawn.
    pub radii: Tensor<1, Int>,
}

impl Scene {
    /// A scene from canonical Gaussians, completed for the model, with a new field.
    pub fn new(gaussians: HostGaussians, spec: SceneSpec, seed: u64, device: &Device) -> Self {
        let gaussians = gaussians.completed(&spec.model, seed);
        let field = match &spec.d3dgs {
            Some(network) => DeformationField::d3dgs(network, seed, device),
            None => DeformationField::new(&spec.model, spec.centre, spec.half_size, seed, device),
        };
        Self { gaussians: Gaussians::from_host(gaussians, device), field, spec }
    }

    /// A scene with these parameters, by name, as returned by [`params::collect`].
    ///
    /// # Errors
    /// If one is missing or does not fit the spec.
    ///
    /// # Panics
    /// As for [`DeformationField::new`].
    pub fn from_tensors(
        spec: SceneSpec,
        tensors: &BTreeMap<String, HostTensor>,
        device: &Device,
    ) -> Result<Self, FitError> {
        let one = HostGaussians::one(&spec.model);
        params::load(Self::new(one, spec, 0, device), tensors)
    }

    /// The Gaussians at `time` in [0, 1].
    pub fn deformed(&self, time: f32) -> SplatInputs {
        self.at_without(time, None)
    }

    /// The Gaussians at `time`; those marked in `culled` `[N]` are skipped and come out transparent.
    pub fn at_without(&self, time: f32, culled: Option<&[bool]>) -> SplatInputs {
        if !self.spec.deformed {
            return self.gaussians.val();
        }
        self.field.deform(&self.gaussians, time, culled)
    }

    /// Draws Gaussians already evaluated at their time.
    pub fn draw(
        &self,
        at: SplatInputs,
        camera: PinholeCamera,
        background: [f32; 3],
        offsets: Option<Tensor<2>>,
    ) -> RenderedView {
        let inputs = SplatInputs { screen_offsets: offsets, ..at };
        let out = splat(inputs, Rendering { background, ..self.spec.rendering() }.seen_by(camera));
        RenderedView { image: out.image, radii: out.radii }
    }

    /// The Gaussians at `time` in [0, 1] as input for splatting, without gradients: an autodiff tape would hold the
    /// hidden layers of every rendered view until the next training step.
    pub fn inputs_at(&self, time: f32) -> SplatInputs {
        if self.gaussians.means.val().device().is_autodiff() {
            self.valid().deformed(time)
        } else {
            self.deformed(time)
        }
    }

    /// Renders `[H, W, 4]` (colour over the scene's background, and alpha) to the host.
    pub fn render(&self, camera: PinholeCamera, time: f32) -> Vec<f32> {
        params::to_vec(self.drawn(camera, time))
    }

    /// The image of [`Scene::render`], on the device.
    pub(super) fn drawn(&self, camera: PinholeCamera, time: f32) -> Tensor<3> {
        splat(self.inputs_at(time), self.spec.rendering().seen_by(camera)).image
    }

    /// 16 hexadecimal digits that distinguish this state of the scene from others: a 64-bit FNV-1a hash of the
    /// canonical means, in their order; for a packed scene that of the scene it was packed from.
    pub fn fingerprint(&self) -> String {
        if let Some(fingerprint) = &self.spec.packed_from {
            return fingerprint.clone();
        }
        let means = params::to_vec(self.gaussians.means.val());
        let bytes = means.iter().flat_map(|v| v.to_le_bytes());
        let hash = bytes.fold(0xcbf2_9ce4_8422_2325u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
        format!("{hash:016x}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::paths::{Lens, training_cameras};
    use crate::device::DeviceName;
    use crate::model::ToKernel;
    use crate::model::fixture::scene;

    #[test]
    fn rendering_a_scene_in_training_keeps_no_tape() {
        let device = DeviceName::all()[0].open().unwrap();
        let plain = scene();
        let training = Scene::new(plain.gaussians.to_host(), plain.spec.clone(), 0, &device.autodiff());
        let camera = training_cameras(1, 4.0, Lens { fov_x: 0.5, width: 6, height: 4 })[0].to_kernel();
        assert!(training.deformed(0.3).means.device().is_autodiff());
        assert!(!training.drawn(camera, 0.3).device().is_autodiff());
        assert_eq!(training.render(camera, 0.3), plain.render(camera, 0.3));
    }
}
