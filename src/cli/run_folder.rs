//! A run folder as the commands after training see it.

mod camera;

pub(super) use camera::check_lens;

use super::CliError;
use crate::config::PRESETS;
use crate::config::layers::Layers;
use crate::config::types::Config;
use crate::data::dataset::read_split;
use crate::data::paths::{FOV_X, Lens, RADIUS, Sphere};
use crate::data::{Camera, Split, SplitName};
use crate::edit::EditStack;
use crate::files::{RunLock, Work};
use crate::model::Scene;
use crate::segment::segmentation::{self, Segmentation};
use crate::train::run::RunRecord;
use crate::train::{checkpoint, live, open_measured};
use burn::tensor::Device;
use std::path::{Path, PathBuf};

/// A run, its newest scene and its record.
pub(super) struct RunFolder {
    pub path: PathBuf,
    /// Held by commands that write into the run.
    _lock: Option<RunLock>,
    pub scene: Scene,
    pub scene_path: PathBuf,
    pub record: RunRecord,
    pub config: Config,
}

impl RunFolder {
    /// Opens a run, or one of its checkpoints in place of the newest, to look at it.
    pub(super) fn open(path: &Path, device: &Device) -> Result<Self, CliError> {
        Self::open_with(path, device, None)
    }

    /// Opens a run to write into it: nobody else can until this is dropped. What others wrote before is then read.
    ///
    /// What is written belongs to the newest checkpoint: an older one is refused.
    pub(super) fn open_to_write(path: &Path, device: &Device, work: Work) -> Result<Self, CliError> {
        let run = Self::open_locked(path, device, work)?;
        match run.older_step() {
            None => Ok(run),
            Some(_) => Err(CliError::input(format!(
                "{}: an older checkpoint, and this command writes what belongs to the newest; give {}, or go on from here \
                 first with `volseggs train --resume`",
                path.display(),
                run.path.display()
            ))),
        }
    }

    /// The same for a command that keeps what it writes about an older checkpoint apart, see [`Self::older_step`].
    pub(super) fn open_locked(path: &Path, device: &Device, work: Work) -> Result<Self, CliError> {
        let (run, checkpoint) = checkpoint::locate(path);
        // asked first, so that no lock file is left in a folder that is no run
        check_newest(path)?;
        checkpoint.ok_or_else(|| no_checkpoint(path))?;
        let lock = RunLock::acquire(&run, &super::command_line(), work)?;
        Self::open_with(path, device, Some(lock))
    }

    /// Name of the checkpoint that was opened, where it is not the newest of the run.
    pub(super) fn older_step(&self) -> Option<String> {
        let opened = self.scene_path.parent()?.file_name()?;
        let newest = checkpoint::list(&self.path).pop();
        let is_newest = newest.is_some_and(|(_, path)| path.file_name() == Some(opened));
        (!is_newest).then(|| opened.to_string_lossy().into_owned())
    }

    fn open_with(path: &Path, device: &Device, lock: Option<RunLock>) -> Result<Self, CliError> {
        let load = |checkpoint: &Path| {
            Scene::load(&scene_of(checkpoint), device).map_err(|e| match e.is_damage() {
                true => CliError::input(format!("{e}; {}", checkpoint::advice(checkpoint))),
                false => CliError::input(e),
            })
        };
        check_newest(path)?;
        let (run, found) = live::read_located(path, load)?;
        let (checkpoint, scene) = found.ok_or_else(|| no_checkpoint(path))?;
        let (path, scene_path) = (run.as_path(), scene_of(&checkpoint));
        let read = |name: &str| {
            let file = path.join(name);
            std::fs::read_to_string(&file).map_err(|e| CliError::input(format!("{}: {e}", file.display())))
        };
        let record = serde_json::from_str(&read("run.json")?)
            .map_err(|e| CliError::input(format!("{}: {e}", path.join("run.json").display())))?;
        if !read("config.toml")?.contains("[stages]") {
            let file = path.join("config.toml");
            return Err(CliError::input(format!(
                "{}: is not the configuration of a run any more; restore it",
                file.display()
            )));
        }
        // through the layers, so that a run from before a key existed still opens
        let config_path = path.join("config.toml").to_string_lossy().into_owned();
        let config = Layers::new(PRESETS).source(config_path).resolve::<Config>().map_err(CliError::input)?.value;
        Ok(Self { path: path.to_owned(), _lock: lock, scene, scene_path, record, config })
    }

    /// The lens of the run's dataset, at `size` pixels a side if that is given, and where its cameras stand around the
    /// scene; of the published data, which is said, where the dataset is not there any more.
    pub(super) fn lens(&self, size: Option<u32>) -> (Lens, Sphere) {
        let first = self.split(SplitName::Train, None, Some(1)).ok();
        let first = first.as_ref().and_then(|split| split.frames.first()).map(|f| &f.camera);
        let (width, height) = match (size, first) {
            (Some(s), _) => (s, s),
            (None, Some(c)) => (c.width, c.height),
            (None, None) => (800, 800),
        };
        let fov_x = first.map_or(FOV_X, Camera::fov_x);
        if first.is_none() {
            errln!(
                "note: {}: no training views can be read, so that their camera is not known; a field of view of 30 degrees is \
                 taken, that of the published data",
                self.record.dataset.display()
            );
        }
        let centre = self.scene.spec.centre();
        let sphere = first.map_or(Sphere { centre, radius: RADIUS }, |c| Sphere::through(c, centre));
        (Lens { fov_x, width, height }, sphere)
    }

    /// The file of the run's segments.
    pub(super) fn segments_path(&self) -> PathBuf {
        self.path.join(segmentation::FILE)
    }

    /// The run's segments; none if there is no file yet.
    pub(super) fn segments(&self) -> Result<Segmentation, CliError> {
        let path = self.segments_path();
        let there = path.try_exists().map_err(|e| CliError::failure(format!("{}: {e}", path.display())))?;
        if !there {
            return Ok(Segmentation::new(self.scene.gaussians.count(), self.scene.fingerprint()));
        }
        let found = Segmentation::load(&path).map_err(CliError::input)?;
        self.check_segments(&found)?;
        Ok(found)
    }

    /// Refuses segments of another scene than the run's.
    pub(super) fn check_segments(&self, found: &Segmentation) -> Result<(), CliError> {
        if found.scene == self.scene.fingerprint() && found.gaussians == self.scene.gaussians.count() {
            return Ok(());
        }
        Err(CliError::input(format!(
            "{}: made for another state of this scene (it was trained on since); run `volseggs segment coarse {} \
             --replace` to begin again",
            self.segments_path().display(),
            self.path.display()
        )))
    }

    /// The run's edits; none if there is no file yet.
    pub(super) fn edits(&self) -> Result<EditStack, CliError> {
        let path = self.path.join(super::shown::EDITS);
        if path.exists() { EditStack::load(&path).map_err(CliError::input) } else { Ok(EditStack::default()) }
    }

    /// Reads a split of the run's dataset, or of `data` in its place.
    pub(super) fn split(
        &self,
        name: SplitName,
        data: Option<&Path>,
        max_views: Option<usize>,
    ) -> Result<Split, CliError> {
        Ok(read_split(self.dataset(data)?, name, self.config.data.downscale, max_views)?)
    }

    /// The views of it that the run is measured on, see [`open_measured`].
    pub(super) fn measured(
        &self,
        name: SplitName,
        data: Option<&Path>,
        max_views: Option<usize>,
    ) -> Result<Split, CliError> {
        Ok(open_measured(self.dataset(data)?, name, &self.config, max_views)?)
    }

    /// The run's dataset, or `data` in its place, which must be there.
    fn dataset<'a>(&'a self, data: Option<&'a Path>) -> Result<&'a Path, CliError> {
        let root = data.unwrap_or(&self.record.dataset);
        if !root.is_dir() {
            return Err(CliError::input(format!(
                "{}: the dataset is not there any more; point to it with --data",
                root.display()
            )));
        }
        Ok(root)
    }
}

fn scene_of(checkpoint: &Path) -> PathBuf {
    checkpoint.join("scene.safetensors")
}

/// A newest checkpoint that lost a file must not be passed over for an older one without a word. Where a checkpoint is
/// given, the others do not matter.
fn check_newest(path: &Path) -> Result<(), CliError> {
    if checkpoint::locate(path).0 == path {
        checkpoint::newest(path).map_err(CliError::input)?;
    }
    Ok(())
}

fn no_checkpoint(path: &Path) -> CliError {
    let run = path.display();
    let record = std::fs::read_to_string(path.join("run.json")).ok();
    CliError::input(match record.and_then(|text| serde_json::from_str::<RunRecord>(&text).ok()) {
        Some(record) => format!(
            "{run}: training has reached no checkpoint yet; if it is not running any more, start it again with `volseggs train \
             --data {} --config {run}/config.toml --out {run}`",
            record.dataset.display()
        ),
        None => format!("{run}: no checkpoint here; give the folder that `volseggs train --out` made"),
    })
}
