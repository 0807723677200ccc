//! The record of a run, `run.json`: how it was trained, and what is needed of its dataset where that is gone.

use crate::data::{Calibration, Normalisation, Surroundings};
use crate::shell;
use serde::{Deserialize, Serialize};
use std::path::{Component, Path, PathBuf};

/// The record of a run, `run.json`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct RunRecord {
    /// Version of the program.
    pub version: String,
    /// The method.
    pub method: String,
    /// Digest of the program, see [`crate::program`].
    pub build: String,
    /// Digests of other builds that took earlier steps, if the run was resumed with a different one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub earlier_builds: Vec<String>,
    /// Seed.
    pub seed: u64,
    /// Device.
    pub device: String,
    /// Worker threads.
    pub threads: usize,
    /// Dataset folder, absolute.
    pub dataset: PathBuf,
    /// The same folder as seen from the run's, so that both can be moved together.
    pub dataset_from_run: PathBuf,
    /// Fingerprint of the dataset.
    pub fingerprint: String,
    /// Physical space and time of the scene, as the dataset gave them.
    pub calibration: Calibration,
    /// How the scene's coordinates follow from those of the dataset.
    #[serde(default, skip_serializing_if = "Normalisation::is_none")]
    pub normalisation: Normalisation,
    /// Lens and distance of the training cameras.
    pub surroundings: Surroundings,
    /// `running`, `interrupted` or `complete`.
    pub status: String,
    /// Steps taken.
    pub steps: usize,
    /// Seconds of training, excluding pauses and the time between a stop and a resume.
    pub training_seconds: f64,
    /// Gaussians at the end; 0 for a method without primitives.
    pub gaussians: usize,
    /// Peak memory in bytes, the maximum over all processes that trained the run; 0 if unknown.
    pub peak_memory_bytes: u64,
}

/// The error for a dataset that is not where the record says.
#[derive(Debug, thiserror::Error)]
#[error("{}: the dataset is no longer there, nor at {}; give its folder with --data, or record it with `volseggs relocate {} --data DATASET`", recorded.display(), beside.display(), shell::path(run))]
pub struct DatasetMissing {
    /// Where it was.
    pub recorded: PathBuf,
    /// Where it would be if it had been moved together with the run.
    pub beside: PathBuf,
    /// The run's folder.
    pub run: PathBuf,
}

impl RunRecord {
    /// Records the folder of the dataset, `root`, also as seen from the folder `run` of this record.
    pub fn set_dataset(&mut self, run: &Path, root: &Path) {
        let [run, root] = [run, root].map(whole);
        (self.dataset_from_run, self.dataset) = (relative(&run, &root), root);
    }

    /// Returns the folder of the dataset: where it was or, if it is no longer there, where it lies if it was moved together
    /// with `run`, the folder of this record.
    ///
    /// # Errors
    /// If it is at neither place.
    pub fn find_dataset(&self, run: &Path) -> Result<PathBuf, DatasetMissing> {
        if self.dataset.is_dir() {
            return Ok(self.dataset.clone());
        }
        let beside = run.join(&self.dataset_from_run);
        if beside.is_dir() {
            return Ok(std::fs::canonicalize(&beside).unwrap_or(beside));
        }
        Err(DatasetMissing { recorded: self.dataset.clone(), beside, run: run.to_owned() })
    }
}

/// Returns the path from the root of the file system, without links, of a folder that may not exist yet in an existing one.
fn whole(path: &Path) -> PathBuf {
    std::fs::canonicalize(path).unwrap_or_else(|_| {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let folder = std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
        path.file_name().map_or_else(|| path.to_owned(), |name| folder.join(name))
    })
}

/// Returns the path that leads from the folder `from` to `to`; both are absolute, without links.
fn relative(from: &Path, to: &Path) -> PathBuf {
    let shared = from.components().zip(to.components()).take_while(|(a, b)| a == b).count();
    let up = from.components().skip(shared).map(|_| Component::ParentDir);
    up.chain(to.components().skip(shared)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_from_one_folder_leads_to_the_other() {
        for (from, to, path) in [
            ("/a/runs/one", "/a/data", "../../data"),
            ("/a/data/run", "/a/data", ".."),
            ("/a", "/a/data/small", "data/small"),
            ("/x/y", "/z", "../../z"),
        ] {
            assert_eq!(relative(Path::new(from), Path::new(to)), Path::new(path), "{from} {to}");
        }
    }

    #[test]
    fn a_dataset_is_found_at_its_place_and_else_beside_the_run() {
        let root = tempfile::tempdir().unwrap();
        let at = |path: &str| root.path().canonicalize().unwrap().join(path);
        for folder in ["project/data", "project/runs/one"] {
            std::fs::create_dir_all(at(folder)).unwrap();
        }
        let mut record = RunRecord::default();
        record.set_dataset(&at("project/runs/one"), &at("project/data"));
        let find = |run: &str| record.find_dataset(&at(run));
        assert_eq!(find("project/runs/one").unwrap(), at("project/data"));
        std::fs::rename(at("project"), at("moved")).unwrap();
        assert_eq!(find("moved/runs/one").unwrap(), at("moved/data"));
        std::fs::create_dir(at("alone")).unwrap();
        std::fs::rename(at("moved/runs/one"), at("alone/one")).unwrap();
        let error = find("alone/one").unwrap_err().to_string();
        for word in [&at("project/data").display().to_string(), "../../data", "--data", "volseggs relocate"] {
            assert!(error.contains(word), "{word}: {error}");
        }
    }
}
