//! What the page shows of a run's training, whether it is over or still going on, here or in another process: the
//! curves of its log and its progress.

use super::live::Progress;
use crate::compare::curves::{self, smooth};
use crate::files::{RunPaths, read_text};
use crate::run::OpenRun;
use crate::run::status::status;
use crate::train::run::RunRecord;
use crate::versioned;
use schemars::JsonSchema;
use serde::Serialize;
use std::path::Path;
use std::time::{Duration, Instant, SystemTime};

/// Minimum time between readings of the log.
const PAUSE: Duration = Duration::from_secs(1);

/// The training of a run.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct TrainingStatus {
    /// `running`, `interrupted`, `complete` or `broken off`, see [`status`].
    pub status: String,
    /// Steps taken so far.
    pub steps: usize,
    /// Total steps of the run.
    pub all: usize,
    /// (step, loss), smoothed.
    pub loss: Vec<(f64, f64)>,
    /// (step, PSNR on the views trained on, in decibels), smoothed.
    pub train: Vec<(f64, f64)>,
    /// (step, PSNR on a few test views, in decibels).
    pub test: Vec<(f64, f64)>,
    /// Further progress of a training that goes on in this process.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub live: Option<Progress>,
}

/// When a file was written, and how long it is.
pub type FileStamp = Option<(SystemTime, u64)>;

/// Returns the stamp of a file; `None` if it is missing.
pub fn stamp(path: &Path) -> FileStamp {
    let found = std::fs::metadata(path).ok()?;
    Some((found.modified().ok()?, found.len()))
}

/// Watches the log of a run.
#[derive(Debug, Default)]
pub struct LogWatch {
    seen: Option<[FileStamp; 2]>,
    checked: Option<Instant>,
    now: Option<TrainingStatus>,
}

impl LogWatch {
    /// Returns what is known of the training.
    pub fn now(&self) -> Option<&TrainingStatus> {
        self.now.as_ref()
    }

    /// Checks the log, at once if that is `urgent`; returns what is known now, if that has changed. `live` is the
    /// progress of a training in this process.
    pub fn check(&mut self, run: &OpenRun, live: Option<Progress>, urgent: bool) -> Option<&TrainingStatus> {
        if !urgent && self.checked.is_some_and(|when| when.elapsed() < PAUSE) {
            return None;
        }
        self.checked = Some(Instant::now());
        let paths = run.paths();
        let stamps = [paths.metrics(), paths.record()].map(|path| stamp(&path));
        let mut now = match &self.now {
            Some(now) if self.seen == Some(stamps) => now.clone(),
            _ => read(run),
        };
        self.seen = Some(stamps);
        // a killed process no longer updates its status
        now.status = status(&run.path, &now.status).to_owned();
        if let Some(live) = live {
            // the log has only some of the steps
            (now.steps, now.live) = (live.steps, Some(live));
        }
        if self.now.as_ref() == Some(&now) {
            return None;
        }
        self.now = Some(now);
        self.now.as_ref()
    }
}

/// Reads the training of a run; what cannot be read is omitted.
fn read(run: &OpenRun) -> TrainingStatus {
    let curves = curves::read(&run.path);
    let text = read_text(&RunPaths(&run.path).record()).ok();
    let record = text.and_then(|text| versioned::from_json::<RunRecord>(text).ok());
    let record = record.as_ref().unwrap_or(&run.record);
    let stages = &run.config.stages;
    TrainingStatus {
        status: record.status.clone(),
        steps: curves.loss.last().map_or(record.steps, |(step, _)| *step as usize),
        all: stages.warmup_steps + stages.joint_steps,
        loss: smooth(&curves.loss),
        train: smooth(&curves.train),
        test: curves.test,
        live: None,
    }
}
