//! Destination of exported files: a single file that the user named, or a folder with one file per time.

use super::super::{OpenRun, RunError};
use super::ExportUnits;
use crate::data::Calibration;
use crate::export::exporters::Exporter;
use crate::files::{AtomicDir, FolderKind, check_file, same_file};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// Name of the record in a folder of exported files.
const RECORD: &str = "export.json";

/// Kind of a folder of exported files, which the next export may replace.
static KIND: LazyLock<FolderKind> = LazyLock::new(|| {
    let entries = Exporter::all().iter().map(|exporter| &*format!("[0-9]*.{}", exporter.extension).leak()).collect();
    FolderKind { what: "a folder of exported files", markers: &[RECORD], entries: Vec::leak(entries) }
});

/// What a folder of exported files holds.
#[derive(Debug, Serialize)]
pub struct ExportRecord<'a> {
    /// Version of the program.
    pub version: &'static str,
    /// Folder of the run.
    pub run: String,
    /// File name extension of the files.
    pub format: &'static str,
    /// Time of each file in [0, 1], in order.
    pub times: &'a [f64],
    /// Whether the edits of the run are applied.
    pub edited: bool,
    /// Segments in the files; the whole scene if empty.
    pub segments: &'a [String],
    /// Steps in which they were refitted to how other programs draw them, see [`super::RefitPlan`]; 0 as trained.
    pub refit_steps: usize,
    /// Coordinates of Gaussians; absent for labels, whose files hold them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coordinates: Option<ExportUnits>,
    /// Physical space and time of the scene, as far as its data gave them.
    pub calibration: &'a Calibration,
    /// Physical time of each file; absent if it is unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub physical_times: Option<Vec<f64>>,
}

impl<'a> ExportRecord<'a> {
    /// Creates the record of files that this version writes from `run`.
    pub fn new(run: &'a OpenRun, format: &'static str, times: &'a [f64], edited: bool, segments: &'a [String]) -> Self {
        let calibration = run.calibration();
        let physical = calibration.time.as_ref().map(|known| times.iter().map(|time| known.time(*time)).collect());
        Self {
            version: env!("CARGO_PKG_VERSION"),
            run: run.path.display().to_string(),
            format,
            times,
            edited,
            segments,
            refit_steps: 0,
            coordinates: None,
            calibration,
            physical_times: physical,
        }
    }
}

/// The destination of the files. A folder appears once all of them are in it.
#[derive(Debug)]
pub struct ExportOutput {
    path: PathBuf,
    extension: &'static str,
    folder: Option<AtomicDir>,
}

impl ExportOutput {
    /// Creates the destination for the single file `path`.
    ///
    /// # Errors
    /// If something else is there, it is itself one of `needed`, or its folder is missing.
    pub fn file(path: &Path, extension: &'static str, needed: &[&Path]) -> Result<Self, RunError> {
        check_file(path)?;
        if same_file(path, needed.iter().copied()).is_some() {
            let problem = "is an input of this command and would be overwritten; choose another name with --out";
            return Err(RunError::input(format!("{}: {problem}", path.display())));
        }
        Ok(Self { path: path.to_owned(), extension, folder: None })
    }

    /// Creates the destination for numbered files in the folder `path`, and its missing parents.
    ///
    /// # Errors
    /// If something other than an older export is there, or it contains something of `needed`.
    pub fn folder(path: &Path, extension: &'static str, needed: &[&Path]) -> Result<Self, RunError> {
        let folder = AtomicDir::create_replacing(path, &KIND, needed)?;
        Ok(Self { path: path.to_owned(), extension, folder: Some(folder) })
    }

    /// Creates the destination `path`: a folder if there are `many` files.
    ///
    /// # Errors
    /// As for [`ExportOutput::file`] and [`ExportOutput::folder`].
    pub fn new(path: &Path, extension: &'static str, many: bool, needed: &[&Path]) -> Result<Self, RunError> {
        if many { Self::folder(path, extension, needed) } else { Self::file(path, extension, needed) }
    }

    /// Creates a destination in the `folder` of the run, which is created if missing: the file `name`, or the folder
    /// `frames` if there are `many` files.
    ///
    /// # Errors
    /// As for [`ExportOutput::file`] and [`ExportOutput::folder`], or if the folder cannot be created.
    pub fn within(
        folder: &Path,
        name: &str,
        extension: &'static str,
        many: bool,
        needed: &[&Path],
    ) -> Result<Self, RunError> {
        std::fs::create_dir_all(folder).map_err(|e| RunError::failure(format!("{}: {e}", folder.display())))?;
        let name = if many { "frames".to_owned() } else { format!("{name}.{extension}") };
        Self::new(&folder.join(name), extension, many, needed)
    }

    /// Returns the path of the file or folder itself.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the path that the file of time `i` is written to, and its final path.
    pub fn paths_of(&self, i: usize) -> (PathBuf, PathBuf) {
        match &self.folder {
            None => (self.path.clone(), self.path.clone()),
            Some(folder) => {
                let name = format!("{i:04}.{}", self.extension);
                (folder.dir().join(&name), self.path.join(name))
            }
        }
    }

    /// Publishes a folder with its record, replacing an older export.
    ///
    /// # Errors
    /// If something else is there by now, or the file system reports an error.
    pub fn finish(self, record: &ExportRecord<'_>, needed: &[&Path]) -> Result<(), RunError> {
        let Some(folder) = self.folder else { return Ok(()) };
        let json = serde_json::to_vec_pretty(record).map_err(RunError::failure)?;
        std::fs::write(folder.dir().join(RECORD), json)
            .map_err(|e| RunError::failure(format!("{}: {e}", self.path.display())))?;
        Ok(folder.commit_replacing(&KIND, needed)?)
    }
}
