//! Adam over a module's parameters by name, with moments that can follow Gaussians as they are added and removed.

use super::{InPlace, TrainError};
use crate::model::params::{HostTensor, ParameterPath, to_vec};
use burn::module::{Module, ModuleMapper, Param};
use burn::tensor::{Device, Gradients, Tensor, TensorData};
use std::collections::BTreeMap;
use volseggs_kernels::adam::{AdamStep, AdamTensors, LrPattern, NonFinite, adam};

/// First and second moment of one parameter, flat, and the number of steps taken.
#[derive(Clone, Debug)]
struct AdamMoments {
    first: Tensor<1>,
    second: Tensor<1>,
    steps: u64,
}

/// Adam's constants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamConstants {
    /// Decay rates of the moments.
    pub betas: [f64; 2],
    /// Added to the square root of the second moment.
    pub epsilon: f64,
    /// Learning rate of the higher spherical harmonics, as a fraction of that of the first.
    pub sh_rest: f64,
}

/// A non-finite gradient or parameter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NotFinite {
    /// The parameter's name.
    pub name: String,
    /// Which of the two, and the element.
    pub what: NonFinite,
}

impl std::fmt::Display for NotFinite {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.what {
            NonFinite::Gradient(i) => write!(f, "the gradient of {} (element {i})", self.name),
            NonFinite::Parameter(i) => write!(f, "{} (element {i})", self.name),
        }
    }
}

/// The optimiser's state.
#[derive(Debug)]
pub struct Optimizer {
    constants: AdamConstants,
    moments: BTreeMap<String, AdamMoments>,
}

impl Optimizer {
    /// A new optimiser without moments.
    pub fn new(constants: AdamConstants) -> Self {
        Self { constants, moments: BTreeMap::new() }
    }

    /// Takes one step on every parameter that has a gradient and a rate. Returns the module and the first non-finite
    /// parameter or gradient, if any: parameters visited before it have then been updated, and the caller stops and
    /// goes back to the last checkpoint.
    pub fn step<M: Module>(
        &mut self,
        module: M,
        gradients: &mut Gradients,
        rate: impl Fn(&str) -> Option<f64>,
    ) -> (M, Option<NotFinite>) {
        let mut stepper = Stepper { path: ParameterPath::default(), optimizer: self, gradients, rate, bad: None };
        let module = module.map(&mut stepper);
        (module, stepper.bad)
    }

    /// Takes one step, of the number `step`, on every parameter of `module` that has a gradient and a rate.
    ///
    /// # Errors
    /// [`TrainError::NotFinite`] at the first parameter or gradient that is not finite: parameters visited before it
    /// have then been updated, and the caller goes back to the last checkpoint.
    pub fn update<M: Module>(
        &mut self,
        module: &mut InPlace<M>,
        step: usize,
        gradients: &mut Gradients,
        rate: impl Fn(&str) -> Option<f64>,
    ) -> Result<(), TrainError> {
        let bad = module.map(|module| self.step(module, gradients, rate));
        bad.map_or(Ok(()), |bad| Err(TrainError::NotFinite { step, what: bad.to_string() }))
    }

    /// Replaces each of the two moments of parameter `name`, flat, by the result of `f`, for densification.
    pub fn map_moments(&mut self, name: &str, f: impl Fn(&[f32]) -> Vec<f32>) {
        if let Some(m) = self.moments.get_mut(name) {
            for tensor in [&mut m.first, &mut m.second] {
                let device = tensor.device();
                let values = f(&to_vec(tensor.clone()));
                let len = values.len();
                *tensor = Tensor::from_data(TensorData::new(values, [len]), &device);
            }
        }
    }

    /// Returns the state as named tensors; the number of steps is a tensor of two 24-bit halves, exact in f32.
    pub fn to_tensors(&self) -> BTreeMap<String, HostTensor> {
        let mut out = BTreeMap::new();
        for (name, m) in &self.moments {
            for (suffix, tensor) in [("first", &m.first), ("second", &m.second)] {
                let values = to_vec(tensor.clone());
                out.insert(format!("adam.{suffix}.{name}"), HostTensor { shape: vec![values.len()], values });
            }
            let steps = vec![(m.steps >> 24) as f32, (m.steps & 0xff_ffff) as f32];
            out.insert(format!("adam.steps.{name}"), HostTensor { shape: vec![2], values: steps });
        }
        out
    }

    /// Restores the state from [`Optimizer::to_tensors`]; `sizes` holds the number of values of each parameter by name.
    ///
    /// # Errors
    /// A message naming a tensor that does not fit; the state is then incomplete.
    pub fn load(
        &mut self,
        tensors: &BTreeMap<String, HostTensor>,
        sizes: &BTreeMap<String, usize>,
        device: &Device,
    ) -> Result<(), String> {
        let tensor = |t: &HostTensor| Tensor::from_data(TensorData::new(t.values.clone(), [t.values.len()]), device);
        self.moments.clear();
        for (key, first) in tensors {
            let Some(name) = key.strip_prefix("adam.first.") else { continue };
            let second = tensors.get(&format!("adam.second.{name}"));
            let steps = tensors.get(&format!("adam.steps.{name}"));
            let (Some(second), Some(steps)) = (second, steps) else {
                return Err(format!("adam.first.{name} is present without adam.second.{name} and adam.steps.{name}"));
            };
            let [high, low] = steps.values[..] else {
                return Err(format!("adam.steps.{name} has {} values, expected 2", steps.values.len()));
            };
            let half = |v: f32| (0.0..HALF).contains(&v).then_some(v as u64);
            let Some((high, low)) = half(high).zip(half(low)) else {
                return Err(format!("adam.steps.{name} is not a number of steps"));
            };
            let size = sizes.get(name).copied().unwrap_or(0);
            if [first.values.len(), second.values.len()] != [size; 2] {
                return Err(format!("the moments of {name} have {} values, expected {size}", first.values.len()));
            }
            let moments = AdamMoments { first: tensor(first), second: tensor(second), steps: high << 24 | low };
            self.moments.insert(name.to_owned(), moments);
        }
        Ok(())
    }
}

/// Upper bound of each half of a step count, so that f32 holds it exactly.
const HALF: f32 = 16_777_216.0;

struct Stepper<'a, F> {
    path: ParameterPath,
    optimizer: &'a mut Optimizer,
    gradients: &'a mut Gradients,
    rate: F,
    bad: Option<NotFinite>,
}

impl<F: Fn(&str) -> Option<f64>> ModuleMapper for Stepper<'_, F> {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.enter(name);
    }
    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.exit();
    }
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let name = self.path.name();
        let Some(rate) = (self.rate)(&name) else { return param };
        let Some(gradient) = param.val().grad_remove(self.gradients) else { return param };
        if self.bad.is_some() {
            return param;
        }
        let dims = param.dims();
        let len: usize = dims.iter().product();
        let value = param.into_value().inner().reshape([len]);
        let device = value.device();
        let moments = self.optimizer.moments.remove(&name).unwrap_or_else(|| AdamMoments {
            first: Tensor::zeros([len], &device),
            second: Tensor::zeros([len], &device),
            steps: 0,
        });
        let steps = moments.steps + 1;
        let AdamConstants { betas: [beta1, beta2], epsilon, sh_rest } = self.optimizer.constants;
        let correction = |beta: f64| (1.0 - beta.powf(steps as f64)) as f32;
        let pattern = (name == "gaussians.sh" && sh_rest != 1.0).then(|| LrPattern {
            row_len: dims[1..].iter().product(),
            head_len: 3,
            tail_factor: sh_rest as f32,
        });
        let step = AdamStep {
            lr: rate as f32,
            beta1: beta1 as f32,
            beta2: beta2 as f32,
            eps: epsilon as f32,
            bias_correction1: correction(beta1),
            bias_correction2: correction(beta2),
            lr_pattern: pattern,
        };
        let tensors = AdamTensors { param: value, moment_1: moments.first, moment_2: moments.second };
        let (out, bad) = adam(tensors, gradient.reshape([len]), step);
        if let Some(what) = bad {
            self.bad = Some(NotFinite { name: name.clone(), what });
        }
        self.optimizer.moments.insert(name, AdamMoments { first: out.moment_1, second: out.moment_2, steps });
        Param::from_tensor(Tensor::from_inner(out.param.reshape(dims)))
    }
}
