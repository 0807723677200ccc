//! A burn module with its optimiser, for methods that consist of one module.

use super::file::wrong;
use burn::module::Module;
use burn::tensor::{Device, Gradients};
use std::collections::BTreeMap;
use std::path::Path;
use volseggs_core::model::params::{self, HostTensor};
use volseggs_core::model::scene_file::SceneError;
use volseggs_core::train::optimizer::{AdamConstants, Optimizer};
use volseggs_core::train::{InPlace, TrainError};

/// A module trained by Adam.
#[derive(Debug)]
pub(super) struct Learner<M> {
    module: InPlace<M>,
    optimizer: Optimizer,
    constants: AdamConstants,
}

/// Adam with PyTorch's defaults.
pub(super) const PYTORCH_ADAM: AdamConstants = AdamConstants { betas: [0.9, 0.999], epsilon: 1e-8, sh_rest: 1.0 };

/// The module without gradients, and its device.
pub(super) fn plain<M: Module>(module: &M) -> (M, Device) {
    let Some(device) = module.devices().into_iter().next() else { unreachable!("a module has parameters") };
    if device.is_autodiff() { (module.valid(), device.inner()) } else { (module.clone(), device) }
}

impl<M: Module> Learner<M> {
    /// Wraps a module on a device with gradients; there are no moments yet.
    pub fn new(module: M, constants: AdamConstants) -> Self {
        Self { module: InPlace::new(module), optimizer: Optimizer::new(constants), constants }
    }

    /// The module.
    pub fn module(&self) -> &M {
        &self.module
    }

    /// Updates every parameter that has a gradient, with the learning rate for its name.
    ///
    /// # Errors
    /// [`TrainError::NotFinite`] at the first non-finite gradient or parameter.
    pub fn update(
        &mut self,
        step: usize,
        gradients: &mut Gradients,
        rate: impl Fn(&str) -> Option<f64>,
    ) -> Result<(), TrainError> {
        self.optimizer.update(&mut self.module, step, gradients, rate)
    }

    /// Changes parts of the module that are not trained.
    pub fn change(&mut self, f: impl FnOnce(&mut M)) {
        f(&mut self.module);
    }

    /// Discards Adam's moments.
    pub fn restart(&mut self) {
        self.optimizer = Optimizer::new(self.constants);
    }

    /// Adam's moments by name.
    pub fn state(&self) -> BTreeMap<String, HostTensor> {
        self.optimizer.to_tensors()
    }

    /// Resumes with a module and the moments of `state`, which was read from `path`.
    ///
    /// # Errors
    /// If the moments do not fit.
    pub fn resume(
        &mut self,
        module: M,
        state: &BTreeMap<String, HostTensor>,
        path: &Path,
        device: &Device,
    ) -> Result<(), SceneError> {
        let loaded = self.optimizer.load(state, &params::sizes(&module), &device.clone().inner());
        self.module = InPlace::new(module);
        loaded.map_err(|reason| wrong(path, reason))
    }
}
