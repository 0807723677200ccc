//! Training of 4D Gaussians: as in 3DGS, with gradients through the Gaussians at the time of a view.

use super::first::first;
use super::model::Scene4d;
use super::rigid::Neighbours;
use super::rows;
use super::settings::FourDgsConfig;
use burn::tensor::{Device, Gradients, Tensor};
use std::collections::BTreeMap;
use volseggs_base::memory::MemoryBudget;
use volseggs_base::rng::{Purpose, Rng};
use volseggs_core::config::types::Config;
use volseggs_core::model::params::{self, HostTensor, to_vec};
use volseggs_core::model::size::ModelSizes;
use volseggs_core::model::{Model, Rendering, ToKernel};
use volseggs_core::train::budget::{ViewSizes, check_memory};
use volseggs_core::train::check::{Background, check_device, parse_background};
use volseggs_core::train::checkpoint::CheckpointError;
use volseggs_core::train::densify::{self, RowSource, Statistics};
use volseggs_core::train::due::{Changes, DueChanges, PendingDensification, sorts_after};
use volseggs_core::train::gather::{GatheredStatistics, ViewContribution};
use volseggs_core::train::optimizer::{AdamConstants, Optimizer};
use volseggs_core::train::schedule::{self, Stage};
use volseggs_core::train::target::target;
use volseggs_core::train::watch::LossWatch;
use volseggs_core::train::{
    SavedTraining, StepReport, StepTimes, TrainError, Training, evaluation_background, losses, spatial, timed,
};
use volseggs_kernels::activation::logit;
use volseggs_kernels::splat::{CovarianceInputs, splat_covariances};
use volseggs_volume::data::{Dataset, Split};

/// Opacities are reset to at most this value (3DGS).
const RESET: f32 = 0.01;
/// The name in a checkpoint of the summed absolute gradients with respect to peak times.
const BY_TIME: &str = "statistics.by_time";

/// 4D Gaussians in training.
pub(super) struct FourDgsTraining {
    config: Config,
    settings: FourDgsConfig,
    scene: Scene4d,
    optimizer: Optimizer,
    statistics: GatheredStatistics,
    /// Sums of the absolute gradients with respect to peak times `[N]`, if they are needed.
    by_time: Option<Tensor<1>>,
    neighbours: Option<Neighbours>,
    pending: PendingDensification,
    step: usize,
    initial: usize,
    extent: f64,
    background: Background,
    device: Device,
    runs_ahead: bool,
    watch: LossWatch,
}

impl FourDgsTraining {
    pub(super) fn new(
        config: &Config,
        settings: &FourDgsConfig,
        dataset: &Dataset,
        device: &Device,
    ) -> Result<Self, TrainError> {
        let images = &dataset.train.images;
        let size = [images.width as usize, images.height as usize];
        let runs_ahead = volseggs_core::device::runs_ahead(device);
        check_memory(config, sizes, ViewSizes::from_split(&dataset.train), runs_ahead, MemoryBudget::now())?;
        check_device(config, &sizes(config), config.init.points, size, device)?;
        let shown = evaluation_background(&config.data.background)?;
        let device = device.clone().autodiff();
        let scene = first(&dataset.train, config, settings, shown, &device)?;
        let n = scene.gaussians().count();
        let optim = &config.optim;
        let constants = AdamConstants { betas: optim.betas, epsilon: optim.epsilon, sh_rest: optim.sh_rest };
        Ok(Self {
            scene,
            optimizer: Optimizer::new(constants),
            statistics: GatheredStatistics::new(n, runs_ahead),
            by_time: None,
            neighbours: None,
            pending: PendingDensification::default(),
            step: 0,
            initial: n,
            extent: dataset.scene_extent(),
            background: parse_background(&config.data.background)?,
            watch: LossWatch::new(&device, config.output.checkpoint_every, config.stages.warmup_steps),
            runs_ahead,
            device,
            settings: settings.clone(),
            config: config.clone(),
        })
    }

    /// The Gaussians at a time, and the loss on the differences of neighbours' velocities.
    fn at(&mut self, time: f32) -> (CovarianceInputs, Option<Tensor<1>>) {
        let moment = self.scene.gaussians().moment(time);
        let rigid = (self.settings.rigid > 0.0).then(|| {
            let velocities = moment.velocities.clone();
            self.neighbours().loss(velocities).mul_scalar(self.settings.rigid as f32)
        });
        (self.scene.gaussians().drawn(moment, time, self.scene.spec.colours()), rigid)
    }

    /// The neighbours, searched again when due.
    fn neighbours(&mut self) -> &Neighbours {
        if self.step.is_multiple_of(self.settings.rigid_every) {
            self.neighbours = None;
        }
        let (gaussians, count) = (self.scene.gaussians(), self.settings.rigid_neighbours);
        self.neighbours.get_or_insert_with(|| Neighbours::of(&to_vec(gaussians.means.val()), count, &self.device))
    }

    /// Raises the spherical-harmonics degree by one every `stages.sh_every` steps, then the order in time at the same
    /// rate.
    fn raise_degrees(&mut self, stage: Stage) {
        let (most, orders) = (self.config.model.sh_degree, self.settings.time_orders);
        let raised = self.step.checked_div(self.config.stages.sh_every).unwrap_or(usize::MAX);
        self.scene.spec.sh_degree = stage.sh_degree(&self.config);
        self.scene.spec.time_degree = raised.saturating_sub(most).min(orders);
    }

    fn note_by_time(&mut self, gradients: &Gradients) {
        if self.settings.time_threshold == 0.0 {
            return;
        }
        if let Some(gradient) = self.scene.gaussians().times.grad(gradients) {
            let size = gradient.abs();
            self.by_time = Some(match self.by_time.take() {
                Some(sum) => sum + size,
                None => size,
            });
        }
    }

    /// The statistics, with gradients with respect to time counted like those on the screen, each in units of its
    /// threshold.
    fn combined(&self) -> Statistics {
        let mut statistics = self.statistics.to_host();
        if let Some(by_time) = &self.by_time {
            let unit = (self.config.densify.threshold / self.settings.time_threshold) as f32;
            let sums = statistics.gradient.iter_mut().zip(to_vec(by_time.clone()));
            sums.for_each(|(sum, by_time)| *sum = sum.max(by_time * unit));
        }
        statistics
    }

    /// Returns the loss `[1]` of an image `[H, W, 4]`, with that of neighbours' velocities.
    ///
    /// # Errors
    /// [`TrainError::NotFinite`] if it is not finite.
    fn loss(
        &mut self,
        stage: Stage,
        image: Tensor<3>,
        target: Tensor<3>,
        rigid: Option<Tensor<1>>,
    ) -> Result<Tensor<1>, TrainError> {
        let distance = losses::photometric(image.clone(), target.clone(), &self.config.loss);
        let mut loss = distance.loss.mul_scalar(self.config.loss.weight as f32);
        let dssim = losses::dssim_weight(&self.config, stage);
        if dssim > 0.0 {
            loss = loss + losses::dssim(image, target).mul_scalar(dssim as f32);
        }
        if let Some(rigid) = rigid {
            loss = loss + rigid;
        }
        self.watch.check(self.step, &loss, || distance.squared)?;
        Ok(loss)
    }

    /// Counts the step, and prepares what follows it.
    fn end_step(&mut self) {
        let step = self.step;
        self.step += 1;
        self.pending.after_step();
        if self.step == self.total_steps() && sorts_after(self.step, &self.config) {
            self.sort(step);
        }
    }

    /// Applies what was due after the last step.
    fn apply_pending(&mut self) {
        let Some(changes) = self.pending.take(self.step, &self.config, self.initial) else { return };
        let Changes { step, due, sort } = changes;
        if due != DueChanges::default() {
            self.densify(step, due);
        }
        if sort {
            self.sort(step);
        }
    }

    /// Adds, removes and resets what was due after `step`.
    fn densify(&mut self, step: usize, due: DueChanges) {
        let host = self.scene.parameters();
        let values = |name: &str| host.get(name).map_or(&[][..], |t| &t.values);
        let in_space = values("gaussians.log_scales").chunks_exact(4).flat_map(|s| &s[..3]).copied();
        let in_space: Vec<f32> = in_space.collect();
        let logits = values("gaussians.opacity_logits");
        let rows = densify::plan(step, due, &self.combined(), logits, &in_space, &self.config, self.extent);
        self.rearrange(step, &rows, &host);
        if due.reset {
            let mut parameters = self.scene.parameters();
            if let Some(logits) = parameters.get_mut("gaussians.opacity_logits") {
                logits.values.iter_mut().for_each(|o| *o = o.min(logit(RESET)));
            }
            self.scene.replace(&parameters);
            self.optimizer.map_moments("gaussians.opacity_logits", |m| vec![0.0; m.len()]);
        }
        self.statistics.replace(|old| old.renewed(&rows, due));
        if due.adds() {
            self.by_time = None;
        } else {
            self.gather_by_time(&rows);
        }
    }

    /// Sorts the Gaussians along a space-filling curve, with everything stored per Gaussian.
    fn sort(&mut self, step: usize) {
        let host = self.scene.parameters();
        let rows = spatial::curve_order(host.get("gaussians.means").map_or(&[], |t| &t.values));
        self.rearrange(step, &rows, &host);
        self.statistics.replace(|old| old.rearranged(&rows));
        self.gather_by_time(&rows);
    }

    /// Gathers the sums of the gradients with respect to time by `rows`.
    fn gather_by_time(&mut self, rows: &[densify::RowSource]) {
        self.by_time = self.by_time.take().map(|sums| {
            let values = densify::gather(&to_vec(sums.clone()), rows, 1);
            Tensor::from_data(&values[..], &sums.device())
        });
    }

    /// Replaces the Gaussians and their moments by those of `rows`, determined after `step`.
    fn rearrange(&mut self, step: usize, rows: &[RowSource], host: &BTreeMap<String, HostTensor>) {
        let rng = Rng::new(self.config.seed, step as u64, Purpose::Split);
        let new = rows::apply(rows, host, rng, &self.device.clone().inner());
        for (name, tensor) in host {
            let width = rows::width(tensor);
            self.optimizer.map_moments(name, |m| densify::gather_moments(m, rows, width));
        }
        self.scene.replace(&new);
        self.neighbours = None;
    }
}

impl Training for FourDgsTraining {
    fn total_steps(&self) -> usize {
        self.config.stages.warmup_steps
    }

    fn steps_done(&self) -> usize {
        self.step
    }

    fn step(&mut self, split: &Split) -> Result<StepReport, TrainError> {
        let (step, mut times) = (self.step, StepTimes::default());
        timed(&mut times.densify, || self.apply_pending());
        let stage = Stage::from_step(step, &self.config);
        self.raise_degrees(stage);
        let view = schedule::view(&self.config, step, split.frames.len());
        let frame = &split.frames[view];
        let background = self.background.colour(self.config.seed, step);
        let view_target = || target(split, view, background, &self.device, self.runs_ahead);
        let target = timed(&mut times.data, view_target);
        let (at, rigid) = timed(&mut times.deform, || self.at(frame.time as f32));
        let logits = at.opacity_logits.clone();
        let offsets = Tensor::<2>::zeros([self.scene.gaussians().count(), 2], &self.device).require_grad();
        let inputs = CovarianceInputs { screen_offsets: Some(offsets.clone()), ..at };
        let rendering = Rendering { background, ..self.scene.spec.rendering() };
        let drawn = timed(&mut times.splat, || splat_covariances(inputs, rendering.seen_by(frame.camera.to_kernel())));
        let loss = timed(&mut times.loss, || self.loss(stage, drawn.image, target, rigid))?;
        let mut gradients = timed(&mut times.backward, || loss.backward());
        timed(&mut times.densify, || {
            self.note_by_time(&gradients);
            self.statistics.add(ViewContribution {
                screen: offsets.grad_remove(&mut gradients),
                radii: drawn.radii.inner(),
                logits: logits.inner(),
                size: [split.images.width as usize, split.images.height as usize],
            });
        });
        timed(&mut times.adam, || {
            let rate = |name: &str| rate(name, stage, &self.settings, &self.config, self.extent);
            self.optimizer.update(&mut self.scene.module, step, &mut gradients, rate)
        })?;
        timed(&mut times.densify, || self.end_step());
        let ((loss, psnr), primitives) = (self.watch.last(), self.scene.gaussians().count());
        Ok(StepReport { step, stage: "train", loss, psnr, primitives, times })
    }

    fn model(&self) -> &dyn Model {
        &self.scene
    }

    fn state(&self) -> BTreeMap<String, HostTensor> {
        let mut tensors = self.optimizer.to_tensors();
        tensors.extend(self.statistics.to_host().into_tensors());
        tensors.extend(self.neighbours.iter().flat_map(Neighbours::to_tensors));
        tensors.extend(self.pending.to_tensors());
        if let Some(sums) = &self.by_time {
            let values = to_vec(sums.clone());
            tensors.insert(BY_TIME.to_owned(), HostTensor { shape: vec![values.len()], values });
        }
        tensors
    }

    fn resume(&mut self, from: SavedTraining<'_>) -> Result<(), CheckpointError> {
        let bad = |reason: String| CheckpointError::File { path: from.state_path.into(), reason };
        let scene = Scene4d::read(from.model, &self.device)?;
        let (n, inner) = (scene.gaussians().count(), self.device.clone().inner());
        let statistics = Statistics::from_tensors(&from.state, n).map_err(bad)?;
        let neighbours = Neighbours::from_tensors(&from.state, n, self.settings.rigid_neighbours, &self.device);
        let neighbours = neighbours.map_err(bad)?;
        self.by_time = match from.state.get(BY_TIME).map(|t| &t.values) {
            Some(sums) if sums.len() != n => return Err(bad(format!("{BY_TIME} does not have {n} entries"))),
            sums => sums.map(|sums| Tensor::from_data(&sums[..], &inner)),
        };
        self.optimizer.load(&from.state, &params::sizes(&*scene.module), &inner).map_err(bad)?;
        self.statistics.replace(|_| statistics);
        (self.scene, self.neighbours) = (scene, neighbours);
        self.pending = PendingDensification::load(&from.state);
        (self.step, self.initial) = (from.step, from.first_primitives);
        Ok(())
    }

    fn first_primitives(&self) -> usize {
        self.initial
    }
}

/// Sizes of its model.
fn sizes(config: &Config) -> ModelSizes {
    let (settings, degree) = (config.section::<FourDgsConfig>().unwrap_or_default(), config.model.sh_degree);
    let (attributes, colours) = (settings.numbers(degree), settings.colours(degree));
    let kept = settings.kept_values(degree);
    ModelSizes { attributes, colours, parameters: 0, kept, inputs: 0, width: 0, widest: 0 }
}

/// Learning rate of a parameter by its name: as in 3DGS; quaternions use that of its rotations.
fn rate(name: &str, stage: Stage, settings: &FourDgsConfig, config: &Config, extent: f64) -> Option<f64> {
    match name {
        "gaussians.times" => Some(settings.times * extent),
        "gaussians.left" | "gaussians.right" => schedule::learning_rate("gaussians.rotations", stage, config, extent),
        _ => schedule::learning_rate(name, stage, config, extent),
    }
}
