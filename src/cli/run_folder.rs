//! A run folder as the commands after training see it.

use super::CliError;
use crate::config::PRESETS;
use crate::config::layers::Layers;
use crate::config::types::Config;
use crate::data::dataset::read_split;
use crate::data::{Split, SplitName};
use crate::model::Scene;
use crate::train::checkpoint;
use crate::train::run::RunRecord;
use burn::tensor::Device;
use std::path::{Path, PathBuf};

/// A run, its newest scene and its record.
pub(super) struct RunFolder {
    pub path: PathBuf,
    pub scene: Scene,
    pub scene_path: PathBuf,
    pub record: RunRecord,
    pub config: Config,
}

impl RunFolder {
    pub(super) fn open(path: &Path, device: &Device) -> Result<Self, CliError> {
        let scene_path = checkpoint::newest_scene(path).ok_or_else(|| {
            CliError::input(format!(
                "{}: no checkpoint here; give the folder that `volseggs train --out` made",
                path.display()
            ))
        })?;
        let scene = Scene::load(&scene_path, device).map_err(CliError::input)?;
        let read = |name: &str| {
            let file = path.join(name);
            std::fs::read_to_string(&file).map_err(|e| CliError::input(format!("{}: {e}", file.display())))
        };
        let record = serde_json::from_str(&read("run.json")?)
            .map_err(|e| CliError::input(format!("{}: {e}", path.join("run.json").display())))?;
        // through the layers, so that a run from before a key existed still opens
        let config_path = path.join("config.toml").to_string_lossy().into_owned();
        let config = Layers::new(PRESETS).source(config_path).resolve::<Config>().map_err(CliError::input)?.value;
        Ok(Self { path: path.to_owned(), scene, scene_path, record, config })
    }

    /// Reads a split of the run's dataset, or of `data` in its place.
    pub(super) fn split(
        &self,
        name: SplitName,
        data: Option<&Path>,
        max_views: Option<usize>,
    ) -> Result<Split, CliError> {
        let root = data.unwrap_or(&self.record.dataset);
        if !root.is_dir() {
            return Err(CliError::input(format!(
                "{}: the dataset is not there any more; point to it with --data",
                root.display()
            )));
        }
        Ok(read_split(root, name, self.config.data.downscale, max_views)?)
    }
}
