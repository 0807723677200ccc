//! Link between the thread that trains in this process and the drawing thread. The trainer leaves copies of the scene
//! on the host when a window is open; nothing on its device is shared, and only whether to pause is passed back.

use super::hub::Hub;
use crate::config::types::Config;
use crate::model::params::{FitError, HostTensor, collect};
use crate::model::{Scene, SceneSpec};
use crate::run::OpenRun;
use crate::train::observer::{Observer, RunProgress, TrainingAction};
use crate::train::run::RunRecord;
use burn::tensor::Device;
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Minimum time between copies of the scene.
const PERIOD: Duration = Duration::from_secs(1);
/// The same as a multiple of the time that a copy takes, during which the training waits.
const COPY_TIME_FACTOR: u32 = 60;
/// Seconds of training over which the pace is measured.
const PACE: f64 = 3.0;

/// Progress of the training.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Progress {
    /// Steps taken.
    pub steps: usize,
    /// Step that is shown.
    pub shown: usize,
    /// Number of Gaussians that are shown.
    pub gaussians: usize,
    /// Recent steps per second.
    pub pace: Option<f64>,
    /// Seconds until the end at that pace.
    pub left: Option<f64>,
    /// Loss of the last step.
    pub loss: Option<f64>,
    /// Whether it has been asked to pause.
    pub pausing: bool,
    /// Whether it is paused.
    pub paused: bool,
}

/// A copy of the scene after some steps.
#[derive(Debug)]
pub struct SceneCopy {
    step: usize,
    spec: SceneSpec,
    tensors: BTreeMap<String, HostTensor>,
}

impl SceneCopy {
    fn new(now: &RunProgress<'_>, scene: &Scene) -> Self {
        Self { step: now.steps, spec: scene.spec.clone(), tensors: collect(scene) }
    }

    /// Returns the scene on a device, and its step.
    ///
    /// # Errors
    /// If it does not fit its own spec.
    pub fn open(self, device: &Device) -> Result<(Scene, usize), FitError> {
        Ok((Scene::from_tensors(self.spec, &self.tensors, device)?, self.step))
    }
}

/// A run before its first step.
#[derive(Debug)]
pub struct BegunRun {
    path: PathBuf,
    record: RunRecord,
    config: Config,
    copy: SceneCopy,
}

impl BegunRun {
    /// Returns the run, with its scene on a device.
    ///
    /// # Errors
    /// If the scene does not fit its own spec.
    pub fn open(self, device: &Device) -> Result<OpenRun, FitError> {
        let Self { path, record, config, copy } = self;
        let (scene, step) = copy.open(device)?;
        Ok(OpenRun::in_training(&path, scene, step, record, config))
    }
}

/// What windows want from the trainer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum TrainerRequest {
    /// Nothing: no window is open.
    #[default]
    Nothing,
    /// The scene when the training pauses or ends.
    AtRest,
    /// The current scene.
    Now,
}

#[derive(Debug, Default)]
struct LiveState {
    progress: Progress,
    wish: TrainerRequest,
    copy: Option<SceneCopy>,
    run: Option<BegunRun>,
    /// Whether something is to be sent at once.
    news: bool,
    /// Why the training ended, if it has.
    end: Option<String>,
}

/// What the two threads share.
#[derive(Debug)]
pub struct Live {
    state: Mutex<LiveState>,
    begins: Condvar,
    hub: Arc<Hub>,
}

impl Live {
    /// Makes the state of a training that has not begun; `hub` wakes the drawing thread.
    pub fn new(hub: Arc<Hub>) -> Self {
        Self { state: Mutex::default(), begins: Condvar::new(), hub }
    }

    /// Waits for the run with the scene before the first step; `None` if the training ends before that.
    pub fn begun(&self) -> Option<BegunRun> {
        let mut state = self.lock();
        while state.run.is_none() && state.end.is_none() {
            state = self.begins.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        state.run.take()
    }

    /// Returns the progress of the training.
    pub fn progress(&self) -> Progress {
        self.lock().progress.clone()
    }

    /// Sets what windows want.
    pub fn wish(&self, wish: TrainerRequest) {
        self.lock().wish = wish;
    }

    /// Takes the copy that the trainer left, which is shown from now on.
    pub fn take(&self) -> Option<SceneCopy> {
        self.lock().copy.take()
    }

    /// Sets what is shown.
    pub fn shows(&self, step: usize, gaussians: usize) {
        let mut state = self.lock();
        (state.progress.shown, state.progress.gaussians) = (step, gaussians);
    }

    /// Whether something is to be sent at once; resets this.
    pub fn has_news(&self) -> bool {
        std::mem::take(&mut self.lock().news)
    }

    /// Makes the training pause before its next step, or go on.
    pub fn pause(&self, pause: bool) {
        let mut state = self.lock();
        (state.progress.pausing, state.news) = (pause, true);
    }

    /// Records that the training is over; `why` is sent to windows.
    pub fn end(&self, why: impl Into<String>) {
        self.lock().end.get_or_insert_with(|| why.into());
        self.begins.notify_all();
    }

    /// Returns why the training ended, if it has.
    pub fn ended(&self) -> Option<String> {
        self.lock().end.clone()
    }

    fn lock(&self) -> MutexGuard<'_, LiveState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Observes the training for windows.
pub struct Onlooker<'a> {
    live: &'a Live,
    /// Called when the first scene is available.
    ready: Option<Box<dyn FnOnce() + 'a>>,
    /// Step of the last copy.
    copied: Option<usize>,
    /// Earliest time of the next copy.
    next: Instant,
    /// Seconds and steps since which the pace is measured.
    since: (f64, usize),
}

impl<'a> Onlooker<'a> {
    /// Makes an observer that leaves scenes with `live`; `ready` is called when the first is available.
    pub fn new(live: &'a Live, ready: impl FnOnce() + 'a) -> Self {
        Self { live, ready: Some(Box::new(ready)), copied: None, next: Instant::now(), since: (0.0, 0) }
    }

    /// Leaves the run with the scene before the first step.
    fn begin(&mut self, now: &RunProgress<'_>, scene: &Scene) {
        let (path, record, config) = (now.run.to_owned(), now.record.clone(), now.config.clone());
        self.live.lock().run = Some(BegunRun { path, record, config, copy: SceneCopy::new(now, scene) });
        self.live.begins.notify_all();
        (self.copied, self.since) = (Some(now.steps), (now.seconds, now.steps));
        if let Some(ready) = self.ready.take() {
            ready();
        }
    }

    /// Returns the steps per second, if they were measured anew.
    fn pace(&mut self, now: &RunProgress<'_>) -> Option<f64> {
        let (seconds, steps) = (now.seconds - self.since.0, now.steps - self.since.1);
        if seconds < PACE || steps == 0 {
            return None;
        }
        self.since = (now.seconds, now.steps);
        Some(steps as f64 / seconds)
    }
}

impl Observer for Onlooker<'_> {
    fn on_step(&mut self, now: &RunProgress<'_>) -> TrainingAction {
        // a viewer of a training that gives no Gaussians was refused before
        let Some(scene) = now.model.scene() else { return TrainingAction::Continue };
        if self.copied.is_none() {
            self.begin(now, scene);
        }
        let (rests, wish) = {
            let state = self.live.lock();
            (state.progress.pausing || now.steps >= now.until, state.wish)
        };
        let due = if rests {
            wish >= TrainerRequest::AtRest
        } else {
            wish == TrainerRequest::Now && Instant::now() >= self.next
        };
        let copy = (due && self.copied != Some(now.steps)).then(|| {
            let began = Instant::now();
            let copy = SceneCopy::new(now, scene);
            self.copied = Some(now.steps);
            self.next = Instant::now() + PERIOD.max(COPY_TIME_FACTOR * began.elapsed());
            copy
        });
        let pace = self.pace(now);

        let mut state = self.live.lock();
        let paused = state.progress.pausing && now.steps < now.until;
        let wakes = copy.is_some() || paused != state.progress.paused;
        let progress = &mut state.progress;
        (progress.steps, progress.paused, progress.pace) = (now.steps, paused, pace.or(progress.pace));
        progress.loss = now.report.map(|report| report.loss).or(progress.loss);
        progress.left = progress.pace.map(|pace| now.until.saturating_sub(now.steps) as f64 / pace);
        state.copy = copy.or(state.copy.take());
        state.news |= wakes;
        drop(state);
        if wakes {
            self.live.hub.wake();
        }
        if paused { TrainingAction::Pause } else { TrainingAction::Continue }
    }
}
