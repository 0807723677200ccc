//! The dataset of a run: where it is, and what the run keeps of it.

use super::{OpenRun, RunError, TrainedModel};
use crate::data::{Calibration, Dataset, OpenOptions, Split, SplitName};
use crate::files::{RunPaths, read_text};
use crate::train::open_measured;
use crate::train::run::RunRecord;
use crate::versioned;
use crate::words::plain;
use std::path::{Path, PathBuf};

impl<S: TrainedModel> OpenRun<S> {
    /// Returns the physical space and time of the scene, as far as its dataset gave them.
    pub fn calibration(&self) -> &Calibration {
        &self.record.calibration
    }

    /// Reads the views of a split that the run is measured on, see [`open_measured`], from its dataset or from `data`.
    ///
    /// # Errors
    /// If the dataset is no longer there, or cannot be read.
    pub fn measured(&self, name: SplitName, data: Option<&Path>, max_views: Option<usize>) -> Result<Split, RunError> {
        let root = self.dataset_or(data)?;
        Ok(open_measured(&root, name, &self.config, max_views, Some(self.record.normalisation))?)
    }

    /// Returns this run with its dataset in the folder `data`, if one is given.
    ///
    /// # Errors
    /// If that does not hold the dataset that the run was trained on.
    pub fn with_dataset(mut self, data: Option<&Path>) -> Result<Self, RunError> {
        let Some(data) = data else { return Ok(self) };
        self.check_dataset(&self.dataset_or(Some(data))?)?;
        self.dataset = Some(data.to_owned());
        Ok(self)
    }

    /// Returns the folder `data` (the value of `--data`), which may hold any dataset, or that of the run's own.
    ///
    /// # Errors
    /// If there is no such folder, or as for [`OpenRun::dataset`].
    pub fn dataset_or(&self, data: Option<&Path>) -> Result<PathBuf, RunError> {
        match data {
            None => self.dataset(),
            Some(data) if data.is_dir() => Ok(data.to_owned()),
            Some(data) => Err(RunError::input(format!(
                "--data {}: there is no such folder; give that of a dataset",
                data.display()
            ))),
        }
    }

    /// Returns the folder that a user gave with [`OpenRun::with_dataset`].
    pub fn given_dataset(&self) -> Option<&Path> {
        self.dataset.as_deref()
    }

    /// Returns the folder of the run's dataset: where a user said it is, where it was, or where it lies if it was moved
    /// together with the run.
    ///
    /// # Errors
    /// If it is at none of these places, or another dataset lies where it should have been moved to.
    pub fn dataset(&self) -> Result<PathBuf, RunError> {
        if let Some(given) = &self.dataset {
            return Ok(given.clone());
        }
        let found = self.record.find_dataset(&self.path).map_err(RunError::input)?;
        if found != self.record.dataset {
            self.check_dataset(&found)?;
        }
        Ok(found)
    }

    /// Checks that the run was trained on this dataset: no later step would notice the views or labels of another one.
    ///
    /// # Errors
    /// If it was trained on another one.
    pub(super) fn check_dataset(&self, root: &Path) -> Result<(), RunError> {
        let options = OpenOptions { downscale: self.config.data.downscale, splits: &[], max_views: Some(1) };
        if Dataset::open(root, &options)?.fingerprint() == self.record.fingerprint {
            return Ok(());
        }
        Err(RunError::input(format!(
            "{}: its training images or cameras are not those that {} was trained on, so it is of another scene; give the \
             dataset of the run with --data",
            root.display(),
            self.path.display()
        )))
    }
}

/// Returns the folder of the dataset that a run was trained on, see [`RunRecord::find_dataset`].
///
/// # Errors
/// If the run's record is missing or damaged, or the dataset is no longer there.
pub fn dataset_of(run: &Path) -> Result<PathBuf, RunError> {
    let path = RunPaths(run).record();
    let bad = |problem: String| {
        let problem = plain(&problem);
        RunError::input(format!("{}: {problem}; give the folder that `volseggs train --out` made", path.display()))
    };
    let text = read_text(&path).map_err(|e| bad(e.to_string()))?;
    let record: RunRecord = versioned::from_json(text).map_err(|e| bad(e.to_string()))?;
    record.find_dataset(run).map_err(RunError::input)
}
