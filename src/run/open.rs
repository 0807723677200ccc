//! A run folder, as used by everything that follows training.

use super::RunError;
use crate::config::types::{Config, segment::SECTION as SEGMENT};
use crate::edit::EditStack;
use crate::files::{LockDuration, RunLock, RunPaths};
use crate::method;
use crate::model::{Model, Scene};
use crate::segment::segmentation::Segmentation;
use crate::shell;
use crate::train::run::RunRecord;
use crate::train::{checkpoint, live};
use crate::versioned;
use burn::tensor::Device;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The model of an opened run: Gaussians, or anything that can be drawn.
pub trait TrainedModel {
    /// Returns it as a model that can be drawn.
    fn model(&self) -> &dyn Model;
}

impl TrainedModel for Scene {
    fn model(&self) -> &dyn Model {
        self
    }
}

impl TrainedModel for Box<dyn Model> {
    fn model(&self) -> &dyn Model {
        &**self
    }
}

/// A run of any method, which can be drawn and measured.
pub type AnyRun = OpenRun<Box<dyn Model>>;

/// A trained run: its newest scene, its record and its configuration. Without a parameter, its method has persistent
/// Gaussians, as segments, tracks, edits and exports need them; an [`AnyRun`] may be of any method.
#[derive(Debug)]
pub struct OpenRun<S = Scene> {
    /// Folder of the run.
    pub path: PathBuf,
    /// Held while the run is being written to.
    _lock: Option<RunLock>,
    /// The trained model, on the device that the run was opened with.
    pub scene: S,
    /// The file that it was read from or, while it is trained in this process, the path of its checkpoint, if there is
    /// one.
    pub scene_path: PathBuf,
    /// The record that training wrote.
    pub record: RunRecord,
    /// The resolved configuration.
    pub config: Config,
    /// Where its dataset is, if a user said so.
    pub(super) dataset: Option<PathBuf>,
}

impl OpenRun {
    /// Opens a run, or one of its checkpoints instead of the newest, for reading.
    ///
    /// # Errors
    /// If there is no checkpoint, a file of the run is damaged, or its method has no persistent Gaussians.
    pub fn open(path: &Path, device: &Device) -> Result<Self, RunError> {
        AnyRun::open_any(path, device)?.gaussians()
    }

    /// Opens a run for writing: nobody else can write to it until this is dropped. It includes all that others wrote
    /// before.
    ///
    /// What is written belongs to the newest checkpoint, so an older one is refused. `command` is shown to others as
    /// the holder of the run.
    ///
    /// # Errors
    /// As for [`OpenRun::open`], or if another process is writing to the run or `path` is an older checkpoint.
    pub fn open_to_write(path: &Path, device: &Device, command: &str, work: LockDuration) -> Result<Self, RunError> {
        let run = AnyRun::open_locked(path, device, command, work)?.gaussians()?;
        match run.older_step() {
            None => Ok(run),
            Some(_) => Err(RunError::input(format!(
                "{}: an older checkpoint, but this command writes data that belongs to the newest; give {}, or first \
                 continue from here with `volseggs train --resume`",
                path.display(),
                run.path.display()
            ))),
        }
    }

    /// Returns the same run again, for work on another thread: the scene is shared and nothing is read. It holds no
    /// lock.
    pub fn share(&self) -> Self {
        let Self { path, scene, scene_path, record, config, dataset, .. } = self;
        let (path, scene_path, record) = (path.clone(), scene_path.clone(), record.clone());
        let (scene, config, dataset) = (scene.clone(), config.clone(), dataset.clone());
        Self { path, _lock: None, scene, scene_path, record, config, dataset }
    }

    /// Creates a run that this process is training, with its scene after `step` steps, which may not be in any file;
    /// `record` is the last one written.
    pub fn in_training(path: &Path, scene: Scene, step: usize, record: RunRecord, config: Config) -> Self {
        let scene_path = scene_at(path, step);
        Self { path: path.to_owned(), _lock: None, scene, scene_path, record, config, dataset: None }
    }

    /// Replaces the scene with the one after `step` steps.
    pub fn advance(&mut self, scene: Scene, step: usize) {
        (self.scene, self.scene_path) = (scene, scene_at(&self.path, step));
    }

    /// Returns the run's segments; none if there is no file yet.
    ///
    /// # Errors
    /// If the file is damaged, or belongs to another scene.
    pub fn segments(&self) -> Result<Segmentation, RunError> {
        let path = self.paths().segments();
        let there = path.try_exists().map_err(|e| RunError::failure(format!("{}: {e}", path.display())))?;
        if !there {
            return Ok(self.no_segments());
        }
        let found = Segmentation::load(&path).map_err(RunError::input)?;
        self.check_segments(&found)?;
        Ok(found)
    }

    /// Returns an empty segmentation of the run's scene.
    pub fn no_segments(&self) -> Segmentation {
        Segmentation::new(self.scene.gaussians.count(), self.scene.fingerprint())
    }

    /// Checks that segments belong to the run's scene.
    ///
    /// # Errors
    /// If they do not; the error says what to do.
    pub(super) fn check_segments(&self, found: &Segmentation) -> Result<(), RunError> {
        if found.scene == self.scene.fingerprint() && found.gaussians == self.scene.gaussians.count() {
            return Ok(());
        }
        Err(RunError::input(format!(
            "{}: made for another state of this scene (it was trained further since); run `volseggs segment coarse {} \
             --replace` to start again",
            self.paths().segments().display(),
            shell::path(&self.path)
        )))
    }
}

impl AnyRun {
    /// Opens a run of any method, or one of its checkpoints instead of the newest, for reading.
    ///
    /// # Errors
    /// If there is no checkpoint, or a file of the run is damaged.
    pub fn open_any(path: &Path, device: &Device) -> Result<Self, RunError> {
        Self::open_with(path, device, None)
    }

    /// Like [`OpenRun::open_any`], for work that writes to the run and keeps results of an older checkpoint apart (see
    /// [`OpenRun::older_step`]): nobody else can write until this is dropped. `command` is shown to others as the
    /// holder of the run.
    ///
    /// # Errors
    /// As for [`OpenRun::open_any`], or if another process is writing to the run.
    pub fn open_locked(path: &Path, device: &Device, command: &str, work: LockDuration) -> Result<Self, RunError> {
        let (run, checkpoint) = checkpoint::locate(path);
        // checked first, so that no lock file is left in a folder that is not a run
        check_newest(path)?;
        checkpoint.ok_or_else(|| no_checkpoint(path))?;
        let lock = RunLock::acquire(&run, command, work)?;
        Self::open_with(path, device, Some(lock))
    }

    /// Converts the run for operations that need persistent Gaussians.
    ///
    /// # Errors
    /// If its method has none.
    pub fn gaussians(self) -> Result<OpenRun, RunError> {
        let Self { path, _lock, scene, scene_path, record, config, dataset } = self;
        match scene.into_scene() {
            Some(scene) => Ok(OpenRun { path, _lock, scene, scene_path, record, config, dataset }),
            None => Err(no_gaussians(&path, &record.method)),
        }
    }

    fn open_with(path: &Path, device: &Device, lock: Option<RunLock>) -> Result<Self, RunError> {
        check_newest(path)?;
        let (folder, checkpoint) = checkpoint::locate(path);
        checkpoint.ok_or_else(|| no_checkpoint(path))?;
        let file = RunPaths(&folder).record();
        let record = record_in(&file)?;
        let method = method::find(&record.method).map_err(|e| RunError::input(format!("{}: {e}", file.display())))?;
        let load = |checkpoint: &Path| {
            method.open(&scene_of(checkpoint), device).map_err(|e| match e.is_damage() {
                true => RunError::input(format!("{e}; {}", checkpoint::advice(checkpoint))),
                false => RunError::input(e),
            })
        };
        let (run, found) = live::read_located(path, load)?;
        let (checkpoint, scene) = found.ok_or_else(|| no_checkpoint(path))?;
        let (path, scene_path) = (run.as_path(), scene_of(&checkpoint));
        let config = config_in(&RunPaths(path).config())?;
        Ok(Self { path: path.to_owned(), _lock: lock, scene, scene_path, record, config, dataset: None })
    }
}

impl<S: TrainedModel> OpenRun<S> {
    /// Returns the trained model as one that can be drawn.
    pub fn model(&self) -> &dyn Model {
        self.scene.model()
    }

    /// Returns the device that it is on.
    pub fn device(&self) -> Device {
        self.model().device()
    }

    /// Takes the lock of a run that is open for reading, for one change; what others wrote in the meantime must be read
    /// again. Waits for short work of others for up to `patience`.
    ///
    /// # Errors
    /// If another process is writing to the run, or the run was trained further since it was opened.
    pub fn lock(&self, command: &str, work: LockDuration, patience: Duration) -> Result<RunLock, RunError> {
        let lock = RunLock::acquire_within(patience, &self.path, command, work)?;
        match self.older_step() {
            None => Ok(lock),
            Some(_) => Err(RunError::input(format!(
                "{}: was trained further since it was opened; open it again",
                self.path.display()
            ))),
        }
    }

    /// Returns the number of steps that the scene was trained for.
    pub fn step(&self) -> Option<usize> {
        checkpoint::step_of(self.scene_path.parent()?)
    }

    /// Returns the name of the opened checkpoint if it is not the newest of the run.
    pub fn older_step(&self) -> Option<String> {
        let opened = self.scene_path.parent()?.file_name()?;
        let newest = checkpoint::list(&self.path).pop();
        let is_newest = newest.is_some_and(|(_, path)| path.file_name() == Some(opened));
        (!is_newest).then(|| opened.to_string_lossy().into_owned())
    }

    /// Returns the seconds of training up to the opened checkpoint.
    pub fn training_seconds(&self) -> f64 {
        // the record describes the last steps of the run, or those before a training that was killed
        let of_checkpoint = (self.step() != Some(self.record.steps)).then(|| self.checkpoint_state()).flatten();
        of_checkpoint.map_or(self.record.training_seconds, |state| state.seconds)
    }

    /// Returns whether the numbers of the opened checkpoint were rounded, see [`pack`](super::pack).
    pub fn is_packed(&self) -> bool {
        self.checkpoint_state().is_some_and(|state| state.packed)
    }

    /// Returns what the checkpoint holds besides its tensors, if there is one.
    fn checkpoint_state(&self) -> Option<checkpoint::CheckpointState> {
        checkpoint::read_state(self.scene_path.parent()?).ok()
    }

    /// Returns the paths of the run's files.
    pub fn paths(&self) -> RunPaths<'_> {
        RunPaths(&self.path)
    }

    /// Returns the run's edits; none if there is no file yet.
    ///
    /// # Errors
    /// If the file is damaged.
    pub fn edits(&self) -> Result<EditStack, RunError> {
        edits_in(&self.paths().edits())
    }
}

fn read(file: &Path) -> Result<String, RunError> {
    std::fs::read_to_string(file).map_err(|e| RunError::input(format!("{}: {e}", file.display())))
}

/// Reads the configuration of a run from its file.
pub(super) fn config_in(file: &Path) -> Result<Config, RunError> {
    let source = file.to_string_lossy().into_owned();
    let resolved = method::layers().source(source).resolve::<Config>().map_err(RunError::input)?;
    let config = resolved.complete(file, SEGMENT).map_err(RunError::input)?;
    config.segment.check().map_err(|e| RunError::input(format!("{}: {e}", file.display())))?;
    Ok(config)
}

/// Reads the edits in a file; none if there is no file yet.
pub(super) fn edits_in(path: &Path) -> Result<EditStack, RunError> {
    if path.exists() { EditStack::load(path).map_err(RunError::input) } else { Ok(EditStack::default()) }
}

/// Reads the record of a run from its file.
fn record_in(file: &Path) -> Result<RunRecord, RunError> {
    versioned::from_json(read(file)?).map_err(|e| RunError::input(format!("{}: {e}", file.display())))
}

/// Creates the error for a request that needs Gaussians on a run whose method has none.
fn no_gaussians(run: &Path, method: &str) -> RunError {
    RunError::input(format!(
        "{}: trained with the method {method}, which has no Gaussians that stay the same over time, but this command \
         needs them; eval, render, sweep and compare work with every method",
        run.display()
    ))
}

/// Returns the path of the scene after `step` steps, where it is if there is such a checkpoint.
fn scene_at(run: &Path, step: usize) -> PathBuf {
    scene_of(&RunPaths(run).checkpoints().join(checkpoint::folder_name(step)))
}

fn scene_of(checkpoint: &Path) -> PathBuf {
    checkpoint.join(RunPaths::SCENE)
}

/// Checks that the newest checkpoint is complete, so that one that lost a file is not silently passed over for an older
/// one. If `path` is a checkpoint, the others do not matter.
fn check_newest(path: &Path) -> Result<(), RunError> {
    if checkpoint::locate(path).0 == path {
        checkpoint::newest(path).map_err(RunError::input)?;
    }
    Ok(())
}

fn no_checkpoint(path: &Path) -> RunError {
    let run = path.display();
    RunError::input(match record_in(&RunPaths(path).record()) {
        Ok(record) => format!(
            "{run}: training has not reached a checkpoint yet; if it is no longer running, start it again with \
             `volseggs train --data {} --config {} --out {}`",
            shell::path(&record.find_dataset(path).unwrap_or(record.dataset)),
            shell::path(&RunPaths(path).config()),
            shell::path(path)
        ),
        Err(_) => format!("{run}: no checkpoint here; give the folder that `volseggs train --out` made"),
    })
}
