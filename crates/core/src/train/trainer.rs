//! One training step at a time: what was due after the last, view, forward, loss, backward, optimiser.

use super::budget::{ViewSizes, check_memory, scene_sizes};
use super::check::{Background, check, check_device, evaluation_background, parse_background};
use super::culling::Culling;
use super::densify;
use super::due::{Changes, DueChanges, PendingDensification, sorts_after};
use super::ema::Ema;
use super::gather::{GatheredStatistics, ViewContribution};
use super::losses::{LossInput, LossTerms, photometric};
use super::optimizer::{AdamConstants, Optimizer};
use super::schedule::{self, Stage};
use super::spatial;
use super::target::target;
use super::time_noise::{TimeNoise, mean_interval};
use super::watch::LossWatch;
use super::{InPlace, StepReport, StepTimes, TrainError, init, timed};
use crate::config::types::{Config, WarmupTimes};
use crate::data::{Camera, Dataset, Split};
use crate::memory::MemoryBudget;
use crate::model::params::to_vec;
use crate::model::scene::RenderedView;
use crate::model::{Gaussians, HostGaussians, Scene, ToKernel};
use burn::tensor::{Device, Tensor};
use volseggs_kernels::activation::logit;
use volseggs_kernels::splat::SplatInputs;

/// The training view of a step.
struct StepView {
    camera: Camera,
    /// In [0, 1].
    time: f64,
    background: [f32; 3],
    /// The view over the background, `[H, W, 4]`.
    target: Tensor<3>,
    /// Width and height, pixels.
    size: [usize; 2],
}

/// The Gaussians at the time of a step's view.
struct Deformed {
    gaussians: SplatInputs,
    /// Whether none was skipped.
    is_whole: bool,
}

/// The state of a training run.
///
/// ```no_run
/// use std::path::Path;
/// use volseggs_core::{config::preset, device::DeviceName, train::Trainer};
/// use volseggs_volume::data::{Dataset, OpenOptions};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let dataset = Dataset::open(Path::new("data/jets"), &OpenOptions::default())?;
/// let mut trainer = Trainer::new(preset("quick")?, &dataset, &DeviceName::all()[0].open()?)?;
/// while trainer.steps_done() < trainer.total_steps() {
///     trainer.step(&dataset.train)?;
/// }
/// trainer.scene().save(Path::new("scene.safetensors"))?;
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Trainer {
    pub(super) config: Config,
    pub(super) scene: InPlace<Scene>,
    pub(super) optimizer: Optimizer,
    pub(super) ema: Ema,
    pub(super) statistics: GatheredStatistics,
    pub(super) culling: Culling,
    pub(super) pending: PendingDensification,
    pub(super) step: usize,
    /// Gaussians at the start: where the line towards the budget begins.
    pub(super) initial: usize,
    extent: f64,
    time_noise: TimeNoise,
    background: Background,
    warmup_views: Vec<usize>,
    terms: LossTerms,
    /// The training views at reduced size, for the first steps.
    pub(super) coarse: Option<Split>,
    device: Device,
    /// Whether reading a value from the device makes it wait.
    runs_ahead: bool,
    watch: LossWatch,
}

impl Trainer {
    /// Starts a run: checks the configuration, carves the hull, places the initial Gaussians.
    ///
    /// # Errors
    /// If the configuration contradicts itself or training cannot start with the data.
    pub fn new(config: Config, dataset: &Dataset, device: &Device) -> Result<Self, TrainError> {
        check(&config)?;
        let (views, runs_ahead) = (ViewSizes::from_split(&dataset.train), crate::device::runs_ahead(device));
        check_memory(&config, scene_sizes, views, runs_ahead, MemoryBudget::now())?;
        let shown = evaluation_background(&config.data.background)?;
        let (mut gaussians, spec) = init::initialise(&dataset.train, &config, shown)?;
        if config.speed.sort_every > 0 {
            let rows = spatial::curve_order(&gaussians.means);
            gaussians = densify::apply(&rows, &gaussians, config.seed, 0);
        }
        let scene = Scene::new(gaussians, spec, config.seed, &device.clone().autodiff());
        Self::from_scene(config, scene, dataset)
    }

    /// Starts a run from an existing scene, on a device with gradients, with new moments.
    ///
    /// # Errors
    /// If the configuration contradicts itself or does not fit the data.
    pub fn from_scene(config: Config, scene: Scene, dataset: &Dataset) -> Result<Self, TrainError> {
        check(&config)?;
        let constants =
            AdamConstants { betas: config.optim.betas, epsilon: config.optim.epsilon, sh_rest: config.optim.sh_rest };
        let is_coarse = config.speed.coarse_steps > 0 && config.speed.coarse_factor > 1;
        let coarse = is_coarse.then(|| dataset.train.reduced(config.speed.coarse_factor)).transpose()?;
        let initial = scene.gaussians.count();
        let device = scene.gaussians.means.val().device();
        let runs_ahead = crate::device::runs_ahead(&device);
        let images = &dataset.train.images;
        let size = [images.width as usize, images.height as usize];
        check_device(&config, &scene_sizes(&config), initial, size, &device)?;
        Ok(Self {
            runs_ahead,
            watch: LossWatch::new(&device, config.output.checkpoint_every, total_steps(&config)),
            device,
            optimizer: Optimizer::new(constants),
            ema: Ema::new(config.optim.average),
            statistics: GatheredStatistics::new(initial, runs_ahead),
            culling: Culling::new(config.speed.cull_visits),
            pending: PendingDensification::default(),
            step: 0,
            initial,
            extent: dataset.scene_extent(),
            time_noise: TimeNoise::new(&config, mean_interval(&dataset.train.times())),
            background: parse_background(&config.data.background)?,
            warmup_views: warmup_views(&dataset.train, config.stages.warmup_times),
            terms: LossTerms::registered(),
            coarse,
            scene: InPlace::new(scene),
            config,
        })
    }

    /// Steps of the whole run.
    pub fn total_steps(&self) -> usize {
        total_steps(&self.config)
    }

    /// Steps already taken.
    pub fn steps_done(&self) -> usize {
        self.step
    }

    /// The scene after the last step.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The scene that is shown and saved: the moving average, if there is one.
    pub(super) fn shown(&self) -> &Scene {
        self.ema.scene().unwrap_or_else(|| self.scene())
    }

    /// The device with gradients that the scene lives on.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Whether the joint stage begins with the next step.
    pub(super) fn begins_joint(&self) -> bool {
        self.step == self.config.stages.warmup_steps && self.config.stages.joint_steps > 0
    }

    /// Updates the moving average after a step; the joint stage begins with an average of its own.
    pub(super) fn update_ema(&mut self) {
        if self.begins_joint() {
            self.ema.clear();
        }
        self.ema.update(self.step, &self.scene);
    }

    /// Takes one step.
    ///
    /// # Errors
    /// [`TrainError::NotFinite`] at the first NaN or infinity, naming it.
    pub fn step(&mut self, split: &Split) -> Result<StepReport, TrainError> {
        let (step, mut times) = (self.step, StepTimes::default());
        timed(&mut times.densify, || self.apply_pending());
        let stage = self.begin_stage();
        let view = timed(&mut times.data, || self.training_view(split, stage));
        let Deformed { gaussians, is_whole } = timed(&mut times.deform, || self.deform(stage, view.time));
        let (drawn, offsets) = timed(&mut times.splat, || self.draw(gaussians.clone(), &view));
        let loss = timed(&mut times.loss, || self.loss(stage, &view, &drawn.image, &gaussians))?;
        let mut gradients = timed(&mut times.backward, || loss.backward());
        timed(&mut times.densify, || {
            let (screen, logits) = (offsets.grad_remove(&mut gradients), gaussians.opacity_logits.inner());
            if stage.is_joint() && is_whole && self.culling.is_on() {
                self.culling.record(view.time, &to_vec(logits.clone()));
            }
            self.statistics.add(ViewContribution { screen, radii: drawn.radii.inner(), logits, size: view.size });
        });
        timed(&mut times.adam, || {
            let rate = |name: &str| schedule::learning_rate(name, stage, &self.config, self.extent);
            self.optimizer.update(&mut self.scene, step, &mut gradients, rate)
        })?;
        timed(&mut times.densify, || self.end_step());
        let ((loss, psnr), primitives) = (self.watch.last(), self.scene.gaussians.count());
        Ok(StepReport { step, stage: stage.name(), loss, psnr, primitives, times })
    }

    /// Applies what was due after the last step.
    fn apply_pending(&mut self) {
        let Some(changes) = self.pending.take(self.step, &self.config, self.initial) else { return };
        let Changes { step, due, sort } = changes;
        if due != DueChanges::default() {
            self.densify(step, due);
        }
        if sort {
            self.sort();
        }
    }

    /// Returns the stage of the step, for which it sets the scene.
    fn begin_stage(&mut self) -> Stage {
        let stage = Stage::from_step(self.step, &self.config);
        self.scene.spec.sh_degree = stage.sh_degree(&self.config);
        self.scene.spec.deformed = stage.is_joint();
        if self.step >= self.config.speed.coarse_steps {
            self.coarse = None; // frees its memory
        }
        stage
    }

    /// Returns the view of the step.
    fn training_view(&self, split: &Split, stage: Stage) -> StepView {
        let split = self.coarse.as_ref().unwrap_or(split);
        let view = match stage {
            Stage::Warmup(s) => self.warmup_views[schedule::view(&self.config, s, self.warmup_views.len())],
            Stage::Joint(s) => schedule::view(&self.config, s, split.frames.len()),
        };
        let frame = &split.frames[view];
        let background = self.background.colour(self.config.seed, self.step);
        StepView {
            camera: frame.camera.clone(),
            time: frame.time,
            background,
            target: target(split, view, background, &self.device, self.runs_ahead),
            size: [split.images.width as usize, split.images.height as usize],
        }
    }

    /// Returns the Gaussians at `time`, without those that may be skipped.
    fn deform(&mut self, stage: Stage, time: f64) -> Deformed {
        let culled = if stage.is_joint() { self.culling.visit(time) } else { None };
        let noisy = self.time_noise.noisy(time, self.step);
        Deformed { gaussians: self.scene.at_without(noisy, culled.as_deref()), is_whole: culled.is_none() }
    }

    /// Returns the image of the view, and offsets of zero `[N, 2]` whose gradient is that of the screen positions.
    fn draw(&self, gaussians: SplatInputs, view: &StepView) -> (RenderedView, Tensor<2>) {
        let offsets = Tensor::zeros([self.scene.gaussians.count(), 2], &self.device).require_grad();
        let camera = view.camera.to_kernel();
        (self.scene.draw(gaussians, camera, view.background, Some(offsets.clone())), offsets)
    }

    /// Returns the loss `[1]` of the image `[H, W, 4]` drawn from `gaussians`.
    ///
    /// # Errors
    /// [`TrainError::NotFinite`] if it is not finite.
    fn loss(
        &mut self,
        stage: Stage,
        view: &StepView,
        image: &Tensor<3>,
        gaussians: &SplatInputs,
    ) -> Result<Tensor<1>, TrainError> {
        let (config, weight, step) = (&self.config, self.config.loss.weight, self.step);
        let StepView { target, camera, .. } = view;
        let distance = photometric(image.clone(), target.clone(), &config.loss);
        let loss = if weight == 1.0 { distance.loss } else { distance.loss.mul_scalar(weight as f32) };
        let (scene, time) = (&*self.scene, view.time as f32);
        let seen = LossInput { image, target, scene, gaussians, camera, config, stage, step, time };
        let loss = self.terms.add_to(loss, &seen);
        self.watch.check(step, &loss, || distance.squared)?;
        Ok(loss)
    }

    /// Counts the step, and prepares what follows it.
    fn end_step(&mut self) {
        self.step += 1;
        self.pending.after_step();
        self.update_ema();
        if self.step == self.total_steps() && sorts_after(self.step, &self.config) {
            self.sort();
        }
    }

    /// Adds, removes and resets what was due after `step`.
    fn densify(&mut self, step: usize, due: DueChanges) {
        let host = self.scene.gaussians.to_host();
        let statistics = self.statistics.to_host();
        let HostGaussians { opacity_logits, log_scales, .. } = &host;
        let rows = densify::plan(step, due, &statistics, opacity_logits, log_scales, &self.config, self.extent);
        let mut new = densify::apply(&rows, &host, self.config.seed, step);
        self.move_moments(&rows, &host);
        if due.reset {
            let ceiling = logit(0.01);
            new.opacity_logits.iter_mut().for_each(|o| *o = o.min(ceiling));
            self.optimizer.map_moments("gaussians.opacity_logits", |m| vec![0.0; m.len()]);
        }
        self.statistics.replace(|old| old.renewed(&rows, due));
        let same = rows.len() == host.len() && rows.iter().zip(0..).all(|(row, i)| *row == densify::RowSource::Keep(i));
        if !same || due.reset {
            self.ema.clear();
        }
        self.replace_gaussians(new);
    }

    /// Sorts the Gaussians, with everything kept about each, along a space-filling curve.
    fn sort(&mut self) {
        let host = self.scene.gaussians.to_host();
        let rows = spatial::curve_order(&host.means);
        let new = densify::apply(&rows, &host, self.config.seed, self.step);
        self.move_moments(&rows, &host);
        self.statistics.replace(|old| old.rearranged(&rows));
        self.ema.rearrange(&rows);
        self.replace_gaussians(new);
    }

    fn move_moments(&mut self, rows: &[densify::RowSource], host: &HostGaussians) {
        for column in host.columns() {
            let gather = |m: &[f32]| densify::gather_moments(m, rows, column.width);
            self.optimizer.map_moments(&format!("gaussians.{}", column.name), gather);
        }
    }

    pub(super) fn replace_gaussians(&mut self, new: HostGaussians) {
        self.culling.clear();
        let device = self.device.clone();
        self.scene.gaussians = Gaussians::from_host(new, &device);
    }
}

fn total_steps(config: &Config) -> usize {
    config.stages.warmup_steps + config.stages.joint_steps
}

fn warmup_views(split: &Split, times: WarmupTimes) -> Vec<usize> {
    let all = split.times();
    let middle = all.get(all.len() / 2).copied();
    (0..split.frames.len()).filter(|&i| times == WarmupTimes::All || Some(split.frames[i].time) == middle).collect()
}
