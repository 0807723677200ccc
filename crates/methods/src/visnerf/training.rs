//! Training: rays of all views at each step, squared colour differences, Adam.

use super::batch::RayBatch;
use super::loss::{RegularisationWeights, regularisers};
use super::model::{VisNerf, VisNerfSpec};
use super::network::parameters;
use crate::learner::{Learner, PYTORCH_ADAM};
use crate::pixels::PixelEpochs;
use crate::visnerf::VisNerfConfig;
use burn::tensor::{Device, Tensor, TensorData};
use std::collections::BTreeMap;
use std::time::Instant;
use volseggs_base::memory::{MemoryBudget, product};
use volseggs_core::config::types::Config;
use volseggs_core::model::Model;
use volseggs_core::model::params::{HostTensor, to_vec};
use volseggs_core::train::checkpoint::CheckpointError;
use volseggs_core::train::watch::LossWatch;
use volseggs_core::train::{SavedTraining, StepReport, StepTimes, TrainError, Training, evaluation_background, timed};
use volseggs_kernels::march::{RaySamples, composite, cpu};
use volseggs_volume::data::{Dataset, Split};

/// A training in progress.
#[derive(Debug)]
pub struct VisNerfTraining {
    learner: Learner<VisNerf>,
    pixels: PixelEpochs,
    seed: u64,
    step: usize,
    watch: LossWatch,
    /// With gradients.
    device: Device,
}

impl VisNerfTraining {
    /// Starts a training on a device without gradients.
    ///
    /// # Errors
    /// If it does not fit into memory, or no position is inside the alpha masks of all views of any time.
    pub fn new(
        settings: &VisNerfConfig,
        config: &Config,
        dataset: &Dataset,
        device: &Device,
    ) -> Result<Self, TrainError> {
        let split = &dataset.train;
        let background = evaluation_background(&config.data.background)?;
        let spec = VisNerfSpec::new(settings, split, background)?;
        check_memory(&spec, MemoryBudget::now())?;
        let pixels = split.images.width as usize * split.images.height as usize;
        let pixels = PixelEpochs::new(split.frames.len(), pixels, pixels, config.seed);
        let watch = LossWatch::new(device, config.output.checkpoint_every, settings.steps);
        let device = device.clone().autodiff();
        let learner = Learner::new(VisNerf::new(spec, config.seed, &device), PYTORCH_ADAM);
        Ok(Self { learner, pixels, seed: config.seed, step: 0, watch, device })
    }

    fn settings(&self) -> &VisNerfConfig {
        &self.learner.module().spec.config
    }

    /// The decay of the learning rates since Adam last restarted, and of the smoothness weights since the first step.
    fn decays(&self) -> [f64; 2] {
        let settings = self.settings();
        let start = settings.restarts.iter().copied().filter(|s| *s <= self.step).max().unwrap_or(0);
        [self.step - start, self.step].map(|n| settings.decay.powf(n as f64 / settings.steps as f64))
    }

    /// Updates the occupancy and restarts Adam before a step, if due.
    fn prepare(&mut self) {
        let settings = self.settings();
        let (marks, restarts) = (
            settings.occupancy > 0 && self.step > 0 && self.step.is_multiple_of(settings.occupancy_every),
            settings.restarts.contains(&self.step),
        );
        if marks {
            let occupancy = self.learner.module().occupied();
            self.learner.change(|model| model.occupancy = occupancy);
        }
        if restarts {
            self.learner.restart();
        }
    }

    /// The colours of the rays of a batch, `[R, 3]`; `None` if no ray has a sample.
    fn see(&self, batch: &RayBatch, times: &mut StepTimes) -> Option<Tensor<2>> {
        let began = Instant::now();
        let model = self.learner.module();
        let (network, spec) = (&model.network, &model.spec);
        let points = &batch.samples.points;
        if points.is_empty() {
            return None;
        }
        let of_samples = batch.rays_of_samples();
        let distance = spec.config.distance_scale * f64::from(batch.step);
        let at = batch.times(of_samples.iter().copied(), &self.device);
        let depths = network.densities(points, &at, &self.device).mul_scalar(distance);
        let weights = cpu::weights(&batch.samples.offsets, &to_vec(depths.clone().inner()));
        let mut coloured: Vec<bool> = weights.iter().map(|w| *w > spec.config.least_weight as f32).collect();
        if !coloured.contains(&true) {
            // not every device can hold an empty tensor, and colouring a sample of little weight does no harm
            coloured[0] = true;
        }
        let chosen: Vec<usize> = (0..coloured.len()).filter(|s| coloured[*s]).collect();
        let places: Vec<f32> = chosen.iter().flat_map(|s| &points[3 * s..3 * s + 3]).copied().collect();
        let directions: Vec<f32> = chosen.iter().flat_map(|s| batch.rays[of_samples[*s]].direction).collect();
        let at = batch.times(chosen.iter().map(|s| of_samples[*s]), &self.device);
        let colours = network.colours(&places, &directions, &at, &self.device);
        times.deform += began.elapsed();
        let rays = RaySamples::new(&batch.samples.offsets, &coloured);
        let seen = timed(&mut times.splat, || composite(depths, colours, &rays, spec.background));
        Some(seen.slice([0..batch.rays.len(), 0..3]))
    }

    /// Returns the loss `[1]` of the colours `[R, 3]` seen along the rays of a batch; `None` if there is nothing to learn.
    ///
    /// # Errors
    /// [`TrainError::NotFinite`] if it is not finite.
    fn loss(&mut self, seen: Option<Tensor<2>>, batch: RayBatch) -> Result<Option<Tensor<1>>, TrainError> {
        let (settings, [_, smoothness]) = (self.settings(), self.decays());
        let weights = RegularisationWeights {
            sparsity: settings.sparsity,
            tv: settings.tv * smoothness,
            tv_time: settings.tv_time * smoothness,
        };
        // if no ray has a sample, images show only the background whatever is learnt
        let difference = seen.map(|seen| {
            let colours = TensorData::new(batch.colours, [batch.rays.len(), 3]);
            (seen - Tensor::from_data(colours, &self.device)).square().mean()
        });
        let prior = regularisers(&self.learner.module().network, weights);
        let Some(loss) = difference.iter().chain(&prior).cloned().reduce(|a, b| a + b) else { return Ok(None) };
        let squared = || difference.map_or_else(|| Tensor::zeros([1], &self.device), Tensor::detach);
        self.watch.check(self.step, &loss, squared)?;
        Ok(Some(loss))
    }
}

impl Training for VisNerfTraining {
    fn total_steps(&self) -> usize {
        self.settings().steps
    }

    fn steps_done(&self) -> usize {
        self.step
    }

    fn step(&mut self, split: &Split) -> Result<StepReport, TrainError> {
        let mut times = StepTimes::default();
        let batch = timed(&mut times.data, || {
            self.prepare();
            RayBatch::draw(self.learner.module(), split, &self.pixels, self.step, self.seed)
        });
        let seen = self.see(&batch, &mut times);
        if let Some(loss) = timed(&mut times.loss, || self.loss(seen, batch))? {
            let mut gradients = timed(&mut times.backward, || loss.backward());
            let ([rates, _], settings) = (self.decays(), self.settings());
            let [of_grid, of_network] = [rates * settings.rate_grid, rates * settings.rate_network];
            let rate = |name: &str| {
                let is_grid = ["planes", "lines", "times"].iter().any(|part| name.ends_with(part));
                Some(if is_grid { of_grid } else { of_network })
            };
            timed(&mut times.adam, || self.learner.update(self.step, &mut gradients, rate))?;
        }
        self.step += 1;
        Ok(self.watch.report(self.step - 1, times))
    }

    fn model(&self) -> &dyn Model {
        self.learner.module()
    }

    fn state(&self) -> BTreeMap<String, HostTensor> {
        self.learner.state()
    }

    fn resume(&mut self, from: SavedTraining<'_>) -> Result<(), CheckpointError> {
        let model = VisNerf::read(from.model, &self.device)?;
        self.learner.resume(model, &from.state, from.state_path, &self.device)?;
        self.step = from.step;
        Ok(())
    }
}

fn check_memory(spec: &VisNerfSpec, budget: MemoryBudget) -> Result<(), TrainError> {
    let config = &spec.config;
    // parameters, gradients and moments
    let held = parameters(config, spec.resolution, spec.knots).saturating_mul(5);
    // per sample: the inputs of both networks, and what the autodiff tape keeps of them and of the grids
    let inputs = (3 + config.features as u128).saturating_mul(1 + 2 * config.octaves as u128);
    let of_sample =
        inputs.saturating_mul(4).saturating_add(2 * (config.density_ranks + config.appearance_ranks) as u128);
    let samples = product(&[config.batch, config.samples_first.max(config.samples_last)]);
    let bytes = samples.saturating_mul(of_sample).saturating_add(held).saturating_mul(4);
    let what = format!("visnerf.batch = {} with this many grid values and samples", config.batch);
    budget.check(what, bytes).map_err(|e| TrainError::Config(e.to_string()))
}
