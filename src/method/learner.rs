//! A burn module with its optimiser, as the methods that are one module train it.

use super::file::wrong;
use crate::model::params::{self, HostTensor};
use crate::model::scene_file::SceneError;
use crate::train::TrainError;
use crate::train::optimizer::{AdamConstants, Optimizer};
use burn::module::Module;
use burn::tensor::{Device, Gradients};
use std::collections::BTreeMap;
use std::path::Path;

/// A module that is being trained by Adam.
#[derive(Debug)]
pub(super) struct Learner<M> {
    /// Absent only while the optimiser holds it.
    module: Option<M>,
    optimizer: Optimizer,
    constants: AdamConstants,
}

/// Adam as PyTorch has it where nothing else is said.
pub(super) const PYTORCH_ADAM: AdamConstants = AdamConstants { betas: [0.9, 0.999], epsilon: 1e-8, sh_rest: 1.0 };

/// The module without gradients, and the device that it is on.
pub(super) fn plain<M: Module>(module: &M) -> (M, Device) {
    let Some(device) = module.devices().into_iter().next() else { unreachable!("a module has parameters") };
    if device.is_autodiff() { (module.valid(), device.inner()) } else { (module.clone(), device) }
}

impl<M: Module> Learner<M> {
    /// A module on a device with gradients, with no moments yet.
    pub fn new(module: M, constants: AdamConstants) -> Self {
        Self { module: Some(module), optimizer: Optimizer::new(constants), constants }
    }

    /// The module.
    pub fn module(&self) -> &M {
        match &self.module {
            Some(module) => module,
            None => unreachable!("the optimiser gives the module back"),
        }
    }

    /// Moves every parameter that has a gradient by the rate of its name.
    ///
    /// # Errors
    /// [`TrainError::NotFinite`] at the first gradient or parameter that is not finite.
    pub fn update(
        &mut self,
        step: usize,
        gradients: &mut Gradients,
        rate: impl Fn(&str) -> Option<f64>,
    ) -> Result<(), TrainError> {
        // taken out, so that the optimiser is the only owner of the memory and may write in place
        let Some(module) = self.module.take() else { return Ok(()) };
        let (module, bad) = self.optimizer.step(module, gradients, rate);
        self.module = Some(module);
        bad.map_or(Ok(()), |bad| Err(TrainError::NotFinite { step, what: bad.to_string() }))
    }

    /// Changes what of the module is no parameter.
    pub fn change(&mut self, f: impl FnOnce(&mut M)) {
        if let Some(module) = &mut self.module {
            f(module);
        }
    }

    /// Forgets Adam's moments.
    pub fn restart(&mut self) {
        self.optimizer = Optimizer::new(self.constants);
    }

    /// Adam's moments by name.
    pub fn state(&self) -> BTreeMap<String, HostTensor> {
        self.optimizer.to_tensors()
    }

    /// Goes on with a module and the moments of `state`, which was read from `path`.
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
        self.module = Some(module);
        loaded.map_err(|reason| wrong(path, reason))
    }
}
