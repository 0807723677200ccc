//! One training step at a time: view, forward, loss, backward, optimiser, densification.

use super::densify::{self, Statistics};
use super::optimizer::{AdamConstants, Optimizer};
use super::schedule::{self, Stage};
use super::{init, losses};
use crate::config::types::{Config, WarmupTimes};
use crate::data::error::DataError;
use crate::data::{Dataset, Split};
use crate::model::params::to_vec;
use crate::model::{Gaussians, Scene};
use crate::rng::{Purpose, Rng};
use burn::tensor::{Device, Tensor, TensorData};
use std::time::{Duration, Instant};

/// Why training stops.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// The data do not allow to start.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A number is not finite.
    #[error(
        "step {step}: {what} is not finite (NaN or infinite); nothing after the last checkpoint was kept. \
         Lower the learning rate of that group, or resume with another seed"
    )]
    NotFinite {
        /// Global step, from 0.
        step: usize,
        /// The loss or the tensor, with the element.
        what: String,
    },
    /// The configuration contradicts itself.
    #[error("configuration: {0}")]
    Config(String),
    /// There is nothing to resume from, or it does not fit.
    #[error(transparent)]
    Resume(super::checkpoint::CheckpointError),
    /// A checkpoint cannot be written.
    #[error(transparent)]
    Save(super::checkpoint::CheckpointError),
    /// A log cannot be written.
    #[error("{path}: {reason}")]
    Log {
        /// The file.
        path: std::path::PathBuf,
        /// What happened.
        reason: String,
    },
}

/// Where the time of a step went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepTimes {
    /// Choosing and compositing the view.
    pub data: Duration,
    /// Field and decoder, forward.
    pub deform: Duration,
    /// Splatting, forward.
    pub splat: Duration,
    /// Loss, forward.
    pub loss: Duration,
    /// Everything backward.
    pub backward: Duration,
    /// Optimiser.
    pub adam: Duration,
    /// Statistics and densification.
    pub densify: Duration,
}

/// What a step did.
#[derive(Clone, Copy, Debug)]
pub struct StepReport {
    /// Global step, from 0.
    pub step: usize,
    /// Its stage.
    pub stage: Stage,
    /// The whole loss.
    pub loss: f64,
    /// PSNR of the step's training view, decibels.
    pub psnr: f64,
    /// Gaussians after the step.
    pub gaussians: usize,
    /// Where the time went.
    pub times: StepTimes,
}

/// The state of a training run.
#[derive(Debug)]
pub struct Trainer {
    pub(super) config: Config,
    /// Absent only while the optimiser holds it.
    pub(super) scene: Option<Scene>,
    pub(super) optimizer: Optimizer,
    pub(super) statistics: Statistics,
    pub(super) step: usize,
    /// Gaussians at the start: the foot of the line towards the budget.
    pub(super) initial: usize,
    extent: f64,
    background: Background,
    warmup_views: Vec<usize>,
    device: Device,
}

/// What lies behind the Gaussians.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Background {
    Fixed([f32; 3]),
    Random,
}

/// The background colour that `data.background` names; white in evaluation where it is `random`.
///
/// # Errors
/// If it is none of the known forms.
pub fn evaluation_background(text: &str) -> Result<[f32; 3], TrainError> {
    match parse_background(text)? {
        Background::Fixed(colour) => Ok(colour),
        Background::Random => Ok([1.0; 3]),
    }
}

fn parse_background(text: &str) -> Result<Background, TrainError> {
    let hex = |s: &str| -> Option<[f32; 3]> {
        let s = s.strip_prefix('#').filter(|s| s.len() == 6 && s.is_ascii())?;
        let byte = |k: usize| u8::from_str_radix(&s[2 * k..2 * k + 2], 16).ok().map(|b| f32::from(b) / 255.0);
        Some([byte(0)?, byte(1)?, byte(2)?])
    };
    match text {
        "white" => Ok(Background::Fixed([1.0; 3])),
        "black" => Ok(Background::Fixed([0.0; 3])),
        "random" => Ok(Background::Random),
        other => hex(other).map(Background::Fixed).ok_or_else(|| {
            TrainError::Config(format!("data.background = \"{other}\": use white, black, random or #rrggbb"))
        }),
    }
}

fn check(config: &Config) -> Result<(), TrainError> {
    let bad = |text: String| Err(TrainError::Config(text));
    if config.model.sh_degree > 3 {
        return bad(format!("model.sh_degree = {}: at most 3", config.model.sh_degree));
    }
    if config.init.points == 0 {
        return bad("init.points = 0: at least 1".into());
    }
    if !(config.init.opacity > 0.0 && config.init.opacity < 1.0) {
        return bad(format!("init.opacity = {}: between 0 and 1", config.init.opacity));
    }
    let m = &config.model;
    for (name, value) in [
        ("levels", m.levels),
        ("channels", m.channels),
        ("time_knots", m.time_knots),
        ("width", m.width),
        ("resolution", m.resolution),
    ] {
        if value == 0 {
            return bad(format!("model.{name} = 0: at least 1"));
        }
    }
    let whole = serde_json::to_value(config).map_err(|e| TrainError::Config(e.to_string()))?;
    if let Some(key) = not_a_rate(&whole, String::new()) {
        return bad(format!("{key}: a finite number, 0 or above"));
    }
    if config.stages.warmup_steps + config.stages.joint_steps == 0 {
        return bad("stages.warmup_steps and stages.joint_steps are both 0: nothing to train".into());
    }
    Ok(())
}

/// The first number below 0 or not finite (which JSON writes as null): no key takes either.
fn not_a_rate(value: &serde_json::Value, key: String) -> Option<String> {
    match value {
        serde_json::Value::Null => Some(key),
        serde_json::Value::Number(n) => n.as_f64().is_none_or(|v| v < 0.0).then_some(key),
        serde_json::Value::Array(items) => items.iter().find_map(|v| not_a_rate(v, key.clone())),
        serde_json::Value::Object(fields) => fields.iter().find_map(|(name, v)| {
            let dot = if key.is_empty() { "" } else { "." };
            not_a_rate(v, format!("{key}{dot}{name}"))
        }),
        _ => None,
    }
}

impl Trainer {
    /// Starts a run: checks the configuration, carves the hull, places the first Gaussians.
    ///
    /// # Errors
    /// If the configuration contradicts itself or the data do not allow to start.
    pub fn new(config: Config, dataset: &Dataset, device: &Device) -> Result<Self, TrainError> {
        check(&config)?;
        let background = parse_background(&config.data.background)?;
        let shown = evaluation_background(&config.data.background)?;
        let device = device.clone().autodiff();
        let (gaussians, spec) = init::initialise(&dataset.train, &config, shown)?;
        let initial = gaussians.opacity_logits.len();
        let scene = Scene::new(gaussians, spec, config.seed, &device);
        let constants =
            AdamConstants { betas: config.optim.betas, epsilon: config.optim.epsilon, sh_rest: config.optim.sh_rest };
        let warmup_views = warmup_views(&dataset.train, config.stages.warmup_times);
        Ok(Self {
            scene: Some(scene),
            optimizer: Optimizer::new(constants),
            statistics: Statistics::new(initial),
            step: 0,
            initial,
            extent: dataset.scene_extent(),
            background,
            warmup_views,
            device,
            config,
        })
    }

    /// Steps of the whole run.
    pub fn total_steps(&self) -> usize {
        self.config.stages.warmup_steps + self.config.stages.joint_steps
    }

    /// Steps already taken.
    pub fn steps_done(&self) -> usize {
        self.step
    }

    /// The scene as it stands.
    pub fn scene(&self) -> &Scene {
        match &self.scene {
            Some(scene) => scene,
            None => unreachable!("the optimiser gives the scene back"),
        }
    }

    fn scene_mut(&mut self) -> &mut Scene {
        match &mut self.scene {
            Some(scene) => scene,
            None => unreachable!("the optimiser gives the scene back"),
        }
    }

    /// The device with gradients that the scene lives on.
    pub fn device(&self) -> &Device {
        &self.device
    }

    fn view(&self, stage: Stage, views: usize) -> usize {
        match stage {
            Stage::Warmup(s) => self.warmup_views[schedule::view(self.config.seed, s, self.warmup_views.len())],
            Stage::Joint(s) => schedule::view(self.config.seed, s, views),
        }
    }

    /// Takes one step.
    ///
    /// # Errors
    /// [`TrainError::NotFinite`] at the first NaN or infinity, naming it.
    pub fn step(&mut self, split: &Split) -> Result<StepReport, TrainError> {
        let mut times = StepTimes::default();
        let mut clock = Instant::now();
        let mut lap = |slot: &mut Duration| {
            let now = Instant::now();
            *slot += now - clock;
            clock = now;
        };
        let step = self.step;
        let stage = Stage::at(step, &self.config);
        let sh_degree = stage.sh_degree(&self.config);
        let spec = &mut self.scene_mut().spec;
        (spec.sh_degree, spec.deformed) = (sh_degree, stage.is_joint());
        let view = self.view(stage, split.frames.len());
        let frame = &split.frames[view];
        let background = match self.background {
            Background::Fixed(colour) => colour,
            Background::Random => {
                let mut rng = Rng::new(self.config.seed, step as u64, Purpose::Background as u64);
                std::array::from_fn(|_| rng.uniform())
            }
        };
        let target = target(split, view, background, &self.device);
        lap(&mut times.data);

        let n = self.scene().gaussians.count();
        let at = self.scene().at(frame.time as f32);
        let logits = at.opacity_logits.clone();
        lap(&mut times.deform);
        let offsets = Tensor::<2>::zeros([n, 2], &self.device).require_grad();
        let drawn = self.scene().draw(at, frame.camera.to_kernel(), background, Some(offsets.clone()));
        lap(&mut times.splat);

        let config = &self.config.loss;
        let mut loss = losses::photometric(drawn.image.clone(), target.clone(), config);
        let dssim = stage.dssim_weight(&self.config);
        if dssim > 0.0 {
            loss = loss + losses::dssim(drawn.image.clone(), target.clone()).mul_scalar(dssim as f32);
        }
        if stage.is_joint()
            && let Some(tv) = losses::smoothness(&self.scene().field.encoder, config)
        {
            loss = loss + tv;
        }
        let value = f64::from(loss.clone().into_scalar::<f32>());
        if !value.is_finite() {
            return Err(TrainError::NotFinite { step, what: format!("the loss ({value})") });
        }
        let psnr = psnr(drawn.image.inner(), target.inner());
        lap(&mut times.loss);
        let mut gradients = loss.backward();
        lap(&mut times.backward);

        let due = densify::due(stage, &self.config, self.initial);
        let screen = offsets.grad_remove(&mut gradients).map(to_vec).unwrap_or_default();
        let radii: Vec<i32> = drawn.radii.into_data().convert::<i32>().try_into_vec().unwrap_or_default();
        self.statistics.add_view(&screen, &radii, split.images.width as usize, split.images.height as usize);
        self.statistics.add_opacity(&to_vec(logits.inner()));
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
        if due != densify::Due::default() {
            self.densify(due);
        }
        lap(&mut times.densify);
        self.step += 1;
        Ok(StepReport { step, stage, loss: value, psnr, gaussians: self.scene().gaussians.count(), times })
    }

    fn densify(&mut self, due: densify::Due) {
        let host = self.scene().gaussians.to_host();
        let rows = densify::plan(due, &self.statistics, &host, &self.config, self.extent);
        let mut new = densify::apply(&rows, &host, self.config.seed, self.step);
        let widths = [
            ("means", 3),
            ("rotations", 4),
            ("log_scales", 3),
            ("opacity_logits", 1),
            ("sh", host.sh.len() / host.opacity_logits.len().max(1)),
        ];
        for (name, width) in widths {
            let gather = |m: &[f32]| densify::gather_moments(m, &rows, width);
            self.optimizer.map_moments(&format!("gaussians.{name}"), gather);
        }
        if due.reset {
            let ceiling = (0.01f32 / 0.99).ln();
            new.opacity_logits.iter_mut().for_each(|o| *o = o.min(ceiling));
            self.optimizer.map_moments("gaussians.opacity_logits", |m| vec![0.0; m.len()]);
        }
        let opacity = densify::gather(&self.statistics.opacity, &rows, 1);
        self.statistics = Statistics::new(rows.len());
        if !due.prune && !due.reset {
            self.statistics.opacity = opacity;
        }
        let device = self.device.clone();
        self.scene_mut().gaussians = Gaussians::from_host(new, &device);
    }
}

fn warmup_views(split: &Split, times: WarmupTimes) -> Vec<usize> {
    let all = split.times();
    let middle = all.get(all.len() / 2).copied();
    (0..split.frames.len()).filter(|&i| times == WarmupTimes::All || Some(split.frames[i].time) == middle).collect()
}

/// The view over the background, with its alpha: `[H, W, 4]`.
fn target(split: &Split, view: usize, background: [f32; 3], device: &Device) -> Tensor<3> {
    let (h, w) = (split.images.height as usize, split.images.width as usize);
    let values = split.images.composite_with_alpha(view, background);
    Tensor::from_data(TensorData::new(values, [h, w, 4]), device)
}

fn psnr(image: Tensor<3>, target: Tensor<3>) -> f64 {
    let (a, b) = (to_vec(image), to_vec(target));
    let mut sum = 0.0f64;
    for (p, q) in a.chunks_exact(4).zip(b.chunks_exact(4)) {
        for c in 0..3 {
            sum += f64::from(p[c] - q[c]).powi(2);
        }
    }
    -10.0 * (sum / (0.75 * a.len() as f64)).max(1e-12).log10()
}
