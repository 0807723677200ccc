//! A trained scene of 4D Gaussians: rendering and file format.

use super::{ColourSeries, Gaussians4d};
use crate::file::{self, ModelFile};
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use volseggs_core::model::params::{self, HostTensor};
use volseggs_core::model::{Counts, Model, Rendering, SceneError};
use volseggs_core::train::InPlace;
use volseggs_kernels::PinholeCamera;
use volseggs_kernels::splat::splat_covariances;

/// Entry of the file's header.
const HEADER: &str = "4dgs";
/// Maximum number of orders that a file may claim.
const MAX_ORDERS: usize = 64;
/// The whole time range, after which the first order of the colours repeats.
const DURATION: f32 = 1.0;

/// What the tensors do not determine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Spec {
    /// Directional coefficients per order in time: 1, 4, 9 or 16.
    pub sh_stride: usize,
    /// Number of orders in time, including the constant one.
    pub orders: usize,
    /// Spherical-harmonics degree in use.
    pub sh_degree: usize,
    /// Highest order in time in use.
    pub time_degree: usize,
    /// The background colour.
    pub background: [f32; 3],
    /// Variance added to each Gaussian on the screen, pixels squared.
    pub dilation: f32,
    /// Centre of the box of the initial Gaussians, scene units.
    pub centre: [f32; 3],
    /// Half the side lengths of this box, scene units.
    pub half_size: [f32; 3],
}

impl Spec {
    pub(super) fn colours(&self) -> ColourSeries {
        ColourSeries { sh_stride: self.sh_stride, time_degree: self.time_degree, duration: DURATION }
    }

    /// The rendering settings.
    pub(super) fn rendering(&self) -> Rendering {
        let Self { background, sh_degree, dilation, .. } = *self;
        Rendering { background, sh_degree, dilation, ..Rendering::default() }
    }

    /// Rejects invalid values before anything is allocated accordingly.
    fn check(&self) -> Result<(), String> {
        let Self { sh_stride, orders, sh_degree, time_degree, .. } = *self;
        if ![1, 4, 9, 16].contains(&sh_stride) || !(1..=MAX_ORDERS).contains(&orders) {
            return Err(format!("{orders} orders of {sh_stride} coefficients: not a valid combination"));
        }
        if sh_degree >= sh_stride.isqrt() || time_degree >= orders {
            return Err(format!(
                "degrees {sh_degree} and {time_degree} do not fit {orders} orders of {sh_stride} coefficients"
            ));
        }
        self.rendering().check()?;
        let numbers = self.background.iter().chain(&self.centre).chain(&self.half_size);
        if !numbers.copied().all(f32::is_finite) || self.half_size.iter().any(|h| *h <= 0.0) {
            return Err("background, centre and half_size must be finite, half_size above 0".into());
        }
        Ok(())
    }
}

/// The module whose parameters are called `gaussians.*`, as in VolSegGS scenes.
#[derive(Module, Debug)]
pub(super) struct Named {
    pub gaussians: Gaussians4d,
}

impl Named {
    /// One Gaussian of all zeros, into which the parameters of a file are loaded.
    fn one(spec: &Spec, device: &Device) -> Self {
        fn zeros<const D: usize>(shape: [usize; D], device: &Device) -> Param<Tensor<D>> {
            Param::from_tensor(Tensor::zeros(shape, device))
        }
        let gaussians = Gaussians4d {
            means: zeros([1, 3], device),
            times: zeros([1], device),
            log_scales: zeros([1, 4], device),
            left: zeros([1, 4], device),
            right: zeros([1, 4], device),
            opacity_logits: zeros([1], device),
            sh: zeros([1, spec.orders * spec.sh_stride, 3], device),
        };
        Self { gaussians }
    }
}

/// A scene of 4D Gaussians.
#[derive(Debug)]
pub(super) struct Scene4d {
    pub module: InPlace<Named>,
    pub spec: Spec,
    device: Device,
}

impl Scene4d {
    /// Returns a scene with these parameters, by name.
    pub(super) fn of(
        spec: Spec,
        tensors: &BTreeMap<String, HostTensor>,
        device: &Device,
    ) -> Result<Self, params::FitError> {
        let module = InPlace::new(params::load(Named::one(&spec, device), tensors)?);
        Ok(Self { module, spec, device: device.clone() })
    }

    /// Reads what [`Model::save`] wrote.
    ///
    /// # Errors
    /// If the file is missing or damaged, belongs to another method, or holds non-finite values.
    pub(super) fn read(path: &Path, device: &Device) -> Result<Self, SceneError> {
        let format = |reason: String| SceneError::Format { path: path.into(), reason };
        let ModelFile::<Spec> { spec, tensors } = file::read(path, HEADER)?;
        spec.check().map_err(|e| format(format!("header: {e}")))?;
        let rows = |tensor: &HostTensor| tensor.shape.first().copied().unwrap_or_default();
        let counts: Vec<usize> = tensors.values().map(rows).collect();
        match counts.first() {
            None | Some(0) => return Err(format("holds no Gaussian".into())),
            Some(first) if counts.iter().any(|n| n != first) => {
                return Err(format("the Gaussians' tensors differ in length".into()));
            }
            Some(_) => {}
        }
        Self::of(spec, &tensors, device).map_err(|source| SceneError::Fit { path: path.into(), source })
    }

    pub(super) fn gaussians(&self) -> &Gaussians4d {
        &self.module.gaussians
    }

    /// Replaces the Gaussians.
    pub(super) fn replace(&mut self, tensors: &BTreeMap<String, HostTensor>) {
        match params::load(Named::one(&self.spec, &self.device), tensors) {
            Ok(module) => self.module = InPlace::new(module),
            Err(error) => unreachable!("rows of the Gaussians fit the Gaussians: {error}"),
        }
    }
}

impl Model for Scene4d {
    fn image(&self, camera: PinholeCamera, time: f32) -> Tensor<3> {
        let colours = self.spec.colours();
        let of = self.gaussians();
        let at = if self.device.is_autodiff() { of.valid().at_time(time, colours) } else { of.at_time(time, colours) };
        splat_covariances(at, self.spec.rendering().seen_by(camera)).image
    }

    fn device(&self) -> Device {
        self.device.clone()
    }

    fn background(&self) -> [f32; 3] {
        self.spec.background
    }

    fn place(&self) -> (DVec3, f64) {
        let Spec { centre, half_size, .. } = &self.spec;
        (DVec3::from_array(centre.map(f64::from)), half_size.iter().copied().fold(f32::MIN_POSITIVE, f32::max).into())
    }

    fn counts(&self) -> Counts {
        Counts { parameters: params::sizes(self.gaussians()).values().sum(), primitives: self.gaussians().count() }
    }

    fn parameters(&self) -> BTreeMap<String, HostTensor> {
        params::collect(&*self.module)
    }

    fn save(&self, path: &Path) -> Result<(), SceneError> {
        file::save(path, HEADER, &self.parameters(), &self.spec)
    }
}
