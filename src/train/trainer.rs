//! One training step at a time: what was due after the last, view, forward, loss, backward, optimiser.

use super::average::Average;
use super::budget::{Views, check_memory};
use super::check::{Background, check, check_device, evaluation_background, parse_background};
use super::culling::Culling;
use super::densify;
use super::due::{Changes, Due, Waiting, sorts_after};
use super::gather::{Gathered, View};
use super::loss_term::LossInput;
use super::optimizer::{AdamConstants, Optimizer};
use super::schedule::{self, Stage};
use super::spatial;
use super::target::target;
use super::watch::LossWatch;
use super::{StepReport, StepTimes, TrainError, init, losses, time_noise};
use crate::config::types::{Config, WarmupTimes};
use crate::data::{Dataset, Split};
use crate::memory::Budget;
use crate::model::params::to_vec;
use crate::model::{Gaussians, HostGaussians, Scene};
use burn::tensor::{Device, Tensor};
use std::time::{Duration, Instant};
use volseggs_kernels::activation::logit;

/// The state of a training run.
#[derive(Debug)]
pub struct Trainer {
    pub(super) config: Config,
    /// Absent only while the optimiser owns it.
    pub(super) scene: Option<Scene>,
    pub(super) optimizer: Optimizer,
    pub(super) average: Average,
    pub(super) statistics: Gathered,
    pub(super) culling: Culling,
    pub(super) waiting: Waiting,
    pub(super) step: usize,
    /// Gaussians at the start: where the line towards the budget begins.
    pub(super) initial: usize,
    extent: f64,
    /// Spacing of the training times.
    interval: f64,
    background: Background,
    warmup_views: Vec<usize>,
    extra: losses::ExtraTerms,
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
        check_memory(&config, Views::of(&dataset.train), crate::device::runs_ahead(device), Budget::now())?;
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
        check_device(&config, initial, [images.width as usize, images.height as usize], &device)?;
        Ok(Self {
            runs_ahead,
            watch: LossWatch::new(&device, config.output.checkpoint_every, total_steps(&config)),
            device,
            optimizer: Optimizer::new(constants),
            average: Average::new(config.optim.average),
            statistics: Gathered::new(initial, runs_ahead),
            culling: Culling::new(config.speed.cull_visits),
            waiting: Waiting::default(),
            step: 0,
            initial,
            extent: dataset.scene_extent(),
            interval: time_noise::mean_interval(&dataset.train.times()),
            background: parse_background(&config.data.background)?,
            warmup_views: warmup_views(&dataset.train, config.stages.warmup_times),
            extra: losses::ExtraTerms::new(&config.loss).map_err(|e| TrainError::Config(e.to_string()))?,
            coarse,
            scene: Some(scene),
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
        match &self.scene {
            Some(scene) => scene,
            None => unreachable!("the optimiser returns the scene"),
        }
    }

    fn scene_mut(&mut self) -> &mut Scene {
        match &mut self.scene {
            Some(scene) => scene,
            None => unreachable!("the optimiser returns the scene"),
        }
    }

    /// The scene that is shown and saved: the moving average, if there is one.
    pub(super) fn shown(&self) -> &Scene {
        self.average.scene().unwrap_or_else(|| self.scene())
    }

    /// The device with gradients that the scene lives on.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Whether the joint stage begins with the next step.
    pub(super) fn begins_joint(&self) -> bool {
        self.step == self.config.stages.warmup_steps && self.config.stages.joint_steps > 0
    }

    /// Lets the average look at the scene after a step; the joint stage begins with an average of its own.
    pub(super) fn update_average(&mut self) {
        if self.begins_joint() {
            self.average.clear();
        }
        if let Some(scene) = &self.scene {
            self.average.look(self.step, scene);
        }
    }

    fn view(&self, stage: Stage, views: usize) -> usize {
        match stage {
            Stage::Warmup(s) => self.warmup_views[schedule::view(&self.config, s, self.warmup_views.len())],
            Stage::Joint(s) => schedule::view(&self.config, s, views),
        }
    }

    /// Takes one step.
    ///
    /// # Errors
    /// [`TrainError::NotFinite`] at the first NaN or infinity, naming it.
    pub fn step(&mut self, split: &Split) -> Result<StepReport, TrainError> {
        let step = self.step;
        if step >= self.config.speed.coarse_steps {
            self.coarse = None; // frees its memory
        }
        // taken out and put back, so that the views can be read while the state changes
        let coarse = self.coarse.take();
        let report = self.step_on(coarse.as_ref().unwrap_or(split), step);
        self.coarse = coarse;
        report
    }

    fn step_on(&mut self, split: &Split, step: usize) -> Result<StepReport, TrainError> {
        let mut times = StepTimes::default();
        let mut clock = Instant::now();
        let mut lap = |slot: &mut Duration| {
            let now = Instant::now();
            *slot += now - clock;
            clock = now;
        };
        if let Some(changes) = self.waiting.take(self.step, &self.config, self.initial) {
            self.change(changes);
        }
        lap(&mut times.densify);
        let stage = Stage::at(step, &self.config);
        let sh_degree = stage.sh_degree(&self.config);
        let spec = &mut self.scene_mut().spec;
        (spec.sh_degree, spec.deformed) = (sh_degree, stage.is_joint());
        let view = self.view(stage, split.frames.len());
        let frame = &split.frames[view];
        let background = self.background.colour(self.config.seed, step);
        let target = target(split, view, background, &self.device, self.runs_ahead);
        lap(&mut times.data);

        let n = self.scene().gaussians.count();
        let culled = if stage.is_joint() { self.culling.visit(frame.time) } else { None };
        let time = time_noise::noisy(frame.time, &self.config, step, self.interval);
        let at = self.scene().at_without(time, culled.as_deref());
        let logits = at.opacity_logits.clone();
        let kept = self.extra.keep(&at);
        lap(&mut times.deform);
        let offsets = Tensor::<2>::zeros([n, 2], &self.device).require_grad();
        let drawn = self.scene().draw(at, frame.camera.to_kernel(), background, Some(offsets.clone()));
        lap(&mut times.splat);

        let config = &self.config.loss;
        let distance = losses::photometric(drawn.image.clone(), target.clone(), config);
        let mut loss =
            if config.weight == 1.0 { distance.loss } else { distance.loss.mul_scalar(config.weight as f32) };
        if let Some(at) = &kept {
            let (image, time, scene) = (&drawn.image, frame.time as f32, self.scene());
            let camera = &frame.camera;
            let input = LossInput { image, target: &target, scene, at, camera, stage, step, time };
            loss = self.extra.add_to(loss, &input);
        }
        let dssim = stage.dssim_weight(&self.config);
        if dssim > 0.0 {
            loss = loss + losses::dssim(drawn.image, target).mul_scalar(dssim as f32);
        }
        if stage.is_joint()
            && let Some(tv) = losses::smoothness(&self.scene().field.encoder, config)
        {
            loss = loss + tv;
        }
        if stage.is_joint() && config.fade > 0.0 {
            let canonical = self.scene().gaussians.opacity_logits.val();
            loss = loss + losses::fading(logits.clone(), canonical).mul_scalar(config.fade as f32);
        }
        self.watch.look(step, &loss, || distance.squared)?;
        lap(&mut times.loss);
        let mut gradients = loss.backward();
        lap(&mut times.backward);

        let logits = logits.inner();
        if stage.is_joint() && culled.is_none() && self.culling.is_on() {
            self.culling.note(frame.time, &to_vec(logits.clone()));
        }
        self.statistics.add(View {
            screen: offsets.grad_remove(&mut gradients),
            radii: drawn.radii.inner(),
            logits,
            size: [split.images.width as usize, split.images.height as usize],
        });
        lap(&mut times.densify);

        let (config, extent) = (&self.config, self.extent);
        // taken out, so that the optimiser is the only owner of the memory and may write in place
        if let Some(scene) = self.scene.take() {
            let rate = |name: &str| schedule::learning_rate(name, stage, config, extent);
            let (scene, bad) = self.optimizer.step(scene, &mut gradients, rate);
            self.scene = Some(scene);
            if let Some(bad) = bad {
                return Err(TrainError::NotFinite { step, what: bad.to_string() });
            }
        }
        lap(&mut times.adam);
        self.step += 1;
        self.waiting.after_step();
        self.update_average();
        if self.step == self.total_steps() && sorts_after(self.step, &self.config) {
            self.sort();
        }
        lap(&mut times.densify);
        let ((loss, psnr), primitives) = (self.watch.last(), self.scene().gaussians.count());
        Ok(StepReport { step, stage: stage.name(), loss, psnr, primitives, times })
    }

    /// Applies what was due after the last step.
    fn change(&mut self, changes: Changes) {
        let Changes { step, due, sort } = changes;
        if due != Due::default() {
            self.densify(step, due);
        }
        if sort {
            self.sort();
        }
    }

    /// Adds, removes and resets what was due after `step`.
    fn densify(&mut self, step: usize, due: Due) {
        let host = self.scene().gaussians.to_host();
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
        let same = rows.len() == host.len() && rows.iter().zip(0..).all(|(row, i)| *row == densify::Row::Keep(i));
        if !same || due.reset {
            self.average.clear();
        }
        self.replace_gaussians(new);
    }

    /// Sorts the Gaussians, with everything kept about each, along a space-filling curve.
    fn sort(&mut self) {
        let host = self.scene().gaussians.to_host();
        let rows = spatial::curve_order(&host.means);
        let new = densify::apply(&rows, &host, self.config.seed, self.step);
        self.move_moments(&rows, &host);
        self.statistics.replace(|old| old.rearranged(&rows));
        self.average.rearrange(&rows);
        self.replace_gaussians(new);
    }

    fn move_moments(&mut self, rows: &[densify::Row], host: &HostGaussians) {
        for column in host.columns() {
            let gather = |m: &[f32]| densify::gather_moments(m, rows, column.width);
            self.optimizer.map_moments(&format!("gaussians.{}", column.name), gather);
        }
    }

    pub(super) fn replace_gaussians(&mut self, new: HostGaussians) {
        self.culling.clear();
        let device = self.device.clone();
        self.scene_mut().gaussians = Gaussians::from_host(new, &device);
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
