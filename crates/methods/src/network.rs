//! Methods that consist of one network, without Gaussians: training, files, resuming and guards follow from a few
//! functions.

use super::{Counts, Method, Model, SavedTraining, Training, file};
use burn::module::Module;
use burn::tensor::{Device, Tensor};
use glam::DVec3;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::path::Path;
use volseggs_base::memory::MemoryBudget;
use volseggs_core::config::types::Config;
use volseggs_core::model::SceneError;
use volseggs_core::model::params::{self, HostTensor};
use volseggs_core::train::checkpoint::CheckpointError;
use volseggs_core::train::optimizer::{AdamConstants, Optimizer};
use volseggs_core::train::watch::LossWatch;
use volseggs_core::train::{InPlace, StepReport, StepTimes, TrainError, evaluation_background, timed};
use volseggs_kernels::PinholeCamera;
use volseggs_volume::data::{Dataset, Split};

/// Entry of the file's header.
const HEADER: &str = "network";
/// Bytes per parameter in training: the parameter, its gradient, two moments and a temporary.
const BYTES: u128 = 20;

/// A method that consists of one network, trained by Adam on a loss of tensors: its [`Method::start`] is [`start`], its
/// [`Method::open`] is [`open`].
pub trait Network: Method + Clone + Debug + 'static {
    /// The network, a burn module.
    type Module: Module + 'static;
    /// Data that creating the network and drawing need besides its tensors; kept in the header of its file.
    type Spec: Serialize + DeserializeOwned + Clone + Debug + Send + 'static;

    /// The network's spec, from checked settings and the data.
    fn spec(&self, config: &Config, dataset: &Dataset) -> Self::Spec;

    /// Number of values in the network of that spec, whatever it says; called before the network is created, also for a
    /// spec from a file.
    ///
    /// # Errors
    /// If no network can have this spec, such as one with a width of 0.
    fn parameters(&self, spec: &Self::Spec) -> Result<u128, String>;

    /// The network with its initial values, which the seed determines. On `device`, with gradients if it has them.
    fn network(&self, spec: &Self::Spec, seed: u64, device: &Device) -> Self::Module;

    /// The loss of a step, `[1]`, and the mean squared error of its colours, `[1]`, for PSNR.
    fn loss(&self, network: &Self::Module, seen: &StepInput<'_, Self::Spec>) -> [Tensor<1>; 2];

    /// Learning rate of a parameter by its name (its path in the module) at a step, from 0; `None` if it is not trained
    /// then.
    fn rate(&self, name: &str, step: usize, config: &Config) -> Option<f64>;

    /// Adam's decay rates and epsilon; PyTorch's defaults unless overridden.
    fn adam(&self, _: &Config) -> AdamConstants {
        AdamConstants { betas: [0.9, 0.999], epsilon: 1e-8, sh_rest: 1.0 }
    }

    /// Centre and half size of the region it shows, scene units, as in [`Model::place`].
    fn place(&self, _: &Self::Spec) -> (DVec3, f64) {
        (DVec3::ZERO, 1.0)
    }

    /// The image of a camera at a time in [0, 1], as in [`Model::image`]; `network` has no gradients.
    fn image(&self, network: &Self::Module, spec: &Self::Spec, camera: PinholeCamera, time: f32) -> Tensor<3>;
}

/// The inputs of the loss of a step.
#[derive(Debug)]
pub struct StepInput<'a, S> {
    /// The network's spec.
    pub spec: &'a S,
    /// The configuration.
    pub config: &'a Config,
    /// The training views.
    pub split: &'a Split,
    /// The colour behind them.
    pub background: [f32; 3],
    /// The step, from 0; random numbers are keyed by `config.seed` and the step.
    pub step: usize,
    /// The device of the network, with gradients.
    pub device: &'a Device,
}

/// A trained network.
#[derive(Debug)]
struct Drawer<N: Network> {
    method: N,
    module: InPlace<N::Module>,
    spec: N::Spec,
    background: [f32; 3],
    device: Device,
}

/// The header of its file.
#[derive(Serialize, Deserialize)]
struct NetworkHeader<S> {
    background: [f32; 3],
    spec: S,
}

/// [`Method::start`] of a network.
///
/// # Errors
/// If no network can have its spec, or it does not fit into memory.
pub fn start<N: Network>(
    method: &N,
    config: &Config,
    dataset: &Dataset,
    device: &Device,
) -> Result<Box<dyn Training>, TrainError> {
    let (method, device) = (method.clone(), device.clone().autodiff());
    let background = evaluation_background(&config.data.background)?;
    let spec = method.spec(config, dataset);
    let bytes = method.parameters(&spec).map_err(TrainError::Config)?.saturating_mul(BYTES);
    let what = format!("the network of the method {}", config.method);
    MemoryBudget::now().check(what, bytes).map_err(|e| TrainError::Config(e.to_string()))?;
    let module = InPlace::new(method.network(&spec, config.seed, &device));
    let (total, optimizer) = (method.steps(config), Optimizer::new(method.adam(config)));
    let watch = LossWatch::new(&device, config.output.checkpoint_every, total);
    let drawer = Drawer { method, module, spec, background, device };
    Ok(Box::new(NetworkTraining { drawer, optimizer, watch, config: config.clone(), total, step: 0 }))
}

/// [`Method::open`] of a network.
///
/// # Errors
/// As there.
pub fn open<N: Network>(method: &N, path: &Path, device: &Device) -> Result<Box<dyn Model>, SceneError> {
    Ok(Box::new(Drawer::read(method.clone(), path, device)?))
}

impl<N: Network> Drawer<N> {
    fn read(method: N, path: &Path, device: &Device) -> Result<Self, SceneError> {
        let file = file::read::<NetworkHeader<N::Spec>>(path, HEADER)?;
        let NetworkHeader { background, spec } = &file.spec;
        let asked = method.parameters(spec).map_err(|e| file::wrong(path, format!("header: {e}")))?;
        file.check_size(path, asked)?;
        let module = InPlace::new(file.fill(path, method.network(spec, 0, device))?);
        let (background, spec) = (*background, spec.clone());
        Ok(Self { method, module, spec, background, device: device.clone() })
    }
}

impl<N: Network> Model for Drawer<N> {
    fn image(&self, camera: PinholeCamera, time: f32) -> Tensor<3> {
        if self.device.is_autodiff() {
            return self.method.image(&self.module.valid(), &self.spec, camera, time);
        }
        self.method.image(&self.module, &self.spec, camera, time)
    }

    fn device(&self) -> Device {
        self.device.clone()
    }

    fn background(&self) -> [f32; 3] {
        self.background
    }

    fn place(&self) -> (DVec3, f64) {
        self.method.place(&self.spec)
    }

    fn counts(&self) -> Counts {
        Counts { parameters: params::sizes(&*self.module).values().sum(), primitives: 0 }
    }

    fn parameters(&self) -> BTreeMap<String, HostTensor> {
        params::collect(&*self.module)
    }

    fn save(&self, path: &Path) -> Result<(), SceneError> {
        file::save(path, HEADER, &self.parameters(), &NetworkHeader { background: self.background, spec: &self.spec })
    }
}

/// A network in training.
struct NetworkTraining<N: Network> {
    drawer: Drawer<N>,
    optimizer: Optimizer,
    watch: LossWatch,
    config: Config,
    total: usize,
    step: usize,
}

impl<N: Network> Training for NetworkTraining<N> {
    fn total_steps(&self) -> usize {
        self.total
    }

    fn steps_done(&self) -> usize {
        self.step
    }

    fn step(&mut self, split: &Split) -> Result<StepReport, TrainError> {
        let (step, mut times) = (self.step, StepTimes::default());
        let Drawer { method, module, spec, background, device } = &mut self.drawer;
        let loss = timed(&mut times.deform, || {
            let seen = StepInput { spec, config: &self.config, split, background: *background, step, device };
            let [loss, squared] = method.loss(module, &seen);
            self.watch.check(step, &loss, || squared).map(|()| loss)
        })?;
        let mut gradients = timed(&mut times.backward, || loss.backward());
        timed(&mut times.adam, || {
            let rate = |name: &str| method.rate(name, step, &self.config);
            self.optimizer.update(module, step, &mut gradients, rate)
        })?;
        self.step += 1;
        Ok(self.watch.report(step, times))
    }

    fn model(&self) -> &dyn Model {
        &self.drawer
    }

    fn state(&self) -> BTreeMap<String, HostTensor> {
        self.optimizer.to_tensors()
    }

    fn resume(&mut self, from: SavedTraining<'_>) -> Result<(), CheckpointError> {
        self.drawer = Drawer::read(self.drawer.method.clone(), from.model, &self.drawer.device)?;
        let (sizes, device) = (params::sizes(&*self.drawer.module), self.drawer.device.clone().inner());
        let loaded = self.optimizer.load(&from.state, &sizes, &device);
        loaded.map_err(|reason| CheckpointError::File { path: from.state_path.into(), reason })?;
        self.step = from.step;
        Ok(())
    }
}
