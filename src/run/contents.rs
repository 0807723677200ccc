//! What a run folder holds, file by file, and which of its files are damaged.

use super::open::{config_in, edits_in};
use super::status::status;
use crate::eval::results::KIND;
use crate::eval::run::Summary;
use crate::files::{RunPaths, read_text};
use crate::metrics::metric::headline;
use crate::model::scene_file::{SceneError, read_tensors, refuse_not_finite};
use crate::segment::masks::MaskReader;
use crate::segment::segmentation::{Segment, Segmentation};
use crate::train::run::RunRecord;
use crate::train::{checkpoint, live, resume};
use crate::versioned;
use serde::Serialize;
use std::path::Path;

/// One file or kind of file of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunItem {
    /// Its path within the run.
    pub file: String,
    /// What it holds, or what is wrong with it, in words.
    pub detail: String,
    /// Whether it can be used.
    pub ok: bool,
}

/// A segment of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SegmentSize {
    /// Its name.
    pub name: String,
    /// Number of its Gaussians.
    pub gaussians: usize,
}

/// What a run folder holds.
#[derive(Clone, Debug, Default, Serialize)]
pub struct RunContents {
    /// `complete`, `interrupted`, `running` or `broken off`; `None` if the record cannot be read.
    pub status: Option<String>,
    /// The record; `None` if it cannot be read.
    pub record: Option<RunRecord>,
    /// Steps of the checkpoints, oldest first.
    pub checkpoints: Vec<usize>,
    /// Number of checkpoints whose files are all whole.
    pub readable: usize,
    /// Bytes of the newest scene.
    pub scene_bytes: Option<u64>,
    /// PSNR of the last evaluation on the test views, decibels.
    pub test_psnr: Option<f64>,
    /// The segments.
    pub segments: Vec<SegmentSize>,
    /// Number of edits in effect.
    pub edits: usize,
    /// All files that were checked.
    pub files: Vec<RunItem>,
}

impl RunContents {
    /// Checks every file of the run in the folder `run` that a command reads. Nothing is changed.
    pub fn list(run: &Path) -> Self {
        let mut found = Self::default();
        let paths = RunPaths(run);
        found.record(run);
        found.checkpoints(run);
        let begun = !found.checkpoints.is_empty();
        // a run that was stopped before its first checkpoint may have no more than its record
        if begun || paths.config().exists() {
            found.add(run, &paths.config(), check_config(run).map(|()| "whole".to_owned()));
        }
        if paths.segments().exists() {
            let segments = Segmentation::load(&paths.segments()).map(|s| {
                let size = |s: &Segment| SegmentSize { name: s.name.to_string(), gaussians: s.members.len() };
                found.segments = s.segments.iter().map(size).collect();
                format!("{} segments", found.segments.len())
            });
            found.add(run, &paths.segments(), segments);
        }
        if paths.masks().exists() {
            let masks = MaskReader::open(&paths.masks()).and_then(|masks| {
                (0..masks.header().views.len()).try_for_each(|view| masks.view(view).map(drop))?;
                Ok(format!("{} masks", masks.len()))
            });
            found.add(run, &paths.masks(), masks);
        }
        if paths.affinity().exists() {
            found.add(run, &paths.affinity(), whole(&paths.affinity()).map(|()| "the affinity field".to_owned()));
        }
        if paths.edits().exists() {
            let edits = edits_in(&paths.edits()).map(|edits| {
                found.edits = edits.operations.len();
                format!("{} edits", found.edits)
            });
            found.add(run, &paths.edits(), edits);
        }
        found.evaluations(run);
        found
    }

    /// The first file that is damaged.
    pub fn damaged(&self) -> Option<&RunItem> {
        self.files.iter().find(|item| !item.ok)
    }

    fn add<E: std::fmt::Display>(&mut self, run: &Path, path: &Path, outcome: Result<String, E>) {
        let file = path.strip_prefix(run).unwrap_or(path).display().to_string();
        let (ok, detail) = match outcome {
            Ok(detail) => (true, detail),
            Err(error) => (false, error.to_string()),
        };
        self.files.push(RunItem { file, detail, ok });
    }

    fn record(&mut self, run: &Path) {
        let path = RunPaths(run).record();
        let text = read_text(&path).map_err(|e| e.to_string());
        let record = text.and_then(|text| versioned::from_json::<RunRecord>(text).map_err(|e| e.to_string()));
        let outcome = record.map(|record| {
            let status = status(run, &record.status).to_owned();
            let detail = format!(
                "{}, {status} after {} steps, {:.1} min, seed {}, {}",
                record.method,
                record.steps,
                record.training_seconds / 60.0,
                record.seed,
                record.dataset.display()
            );
            (self.status, self.record) = (Some(status), Some(record));
            detail
        });
        self.add(run, &path, outcome.map_err(|e| format!("{}: {e}", path.display())));
    }

    fn checkpoints(&mut self, run: &Path) {
        // one that lost a file is not listed
        if let Err(error) = checkpoint::newest(run) {
            self.add(run, &RunPaths(run).checkpoints(), Err(error));
        }
        let check = |path: &Path| -> Result<(), String> {
            checkpoint::read_state(path).map_err(|e| e.to_string())?;
            checkpoint::check_tensors(path).map_err(|e| e.to_string())
        };
        for (step, path, outcome) in live::read_all(run, check) {
            self.checkpoints.push(step);
            let scene = path.join(RunPaths::SCENE);
            let bytes = std::fs::metadata(&scene).map(|m| m.len()).ok();
            if outcome.is_ok() {
                (self.readable, self.scene_bytes) = (self.readable + 1, bytes.or(self.scene_bytes));
            }
            let mib = bytes.unwrap_or_default() as f64 / crate::memory::MIB;
            let advised = outcome.map_err(|e| format!("{e}; {}", checkpoint::advice(&path)));
            self.add(run, &path, advised.map(|()| format!("scene of {mib:.2} MiB, all files whole")));
        }
    }

    /// Results of evaluations.
    fn evaluations(&mut self, run: &Path) {
        let mut folders: Vec<_> = std::fs::read_dir(RunPaths(run).eval()).into_iter().flatten().flatten().collect();
        folders.sort_by_key(std::fs::DirEntry::file_name);
        for folder in folders {
            let path = folder.path().join(KIND.markers[0]);
            if !path.is_file() {
                continue;
            }
            let text = read_text(&path).map_err(|e| format!("{}: {e}", path.display()));
            let read =
                |text: String| versioned::from_json::<Summary>(text).map_err(|e| format!("{}: {e}", path.display()));
            let summary = text.and_then(read).map(|summary| {
                if folder.file_name() == "test" {
                    self.test_psnr = Some(summary.metrics.headline()).filter(|psnr| !psnr.is_nan());
                }
                let (name, value) = (headline().short, summary.metrics.headline_text());
                format!("{name} {value} on {} views of the {} split", summary.views, summary.split)
            });
            self.add(run, &path, summary);
        }
    }
}

/// Checks the configuration, also against that of the newest checkpoint, which is the same but for keys that may change.
fn check_config(run: &Path) -> Result<(), String> {
    let path = RunPaths(run).config();
    config_in(&path).map_err(|e| e.to_string())?;
    let newest = checkpoint::list(run).pop().and_then(|(_, checkpoint)| checkpoint::read_state(&checkpoint).ok());
    let Some(state) = newest else { return Ok(()) };
    let at = |e: String| format!("{}: {e}", path.display());
    let text = read_text(&path).map_err(|e| at(e.to_string()))?;
    match resume::changes(&state.config, &text, state.step).map_err(at)?.1.first() {
        None => Ok(()),
        Some(change) => Err(at(format!("differs from the configuration of the newest checkpoint: {change}"))),
    }
}

fn whole(path: &Path) -> Result<(), SceneError> {
    refuse_not_finite(path, &read_tensors(path)?.0)
}
