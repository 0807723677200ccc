//! The training logs of a run: `metrics.jsonl`, and the same values for TensorBoard.

use super::TakenStep;
use super::beginning::Beginning;
use crate::config::types::OutputConfig;
use crate::files::RunPaths;
use crate::log::jsonl::JsonlWriter;
use crate::log::tensorboard::EventWriter;
use crate::train::report::{MeanTimes, StepTimes};
use crate::train::{StepReport, TrainError};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// A line of `metrics.jsonl`.
#[derive(Serialize)]
struct MetricsLine {
    step: usize,
    seconds: f64,
    stage: &'static str,
    loss: f64,
    train_psnr: f64,
    gaussians: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    test_psnr: Option<f64>,
    /// Of a step, the mean since the line before.
    milliseconds: Milliseconds,
}

#[derive(Serialize)]
struct Milliseconds {
    data: f64,
    deform: f64,
    splat: f64,
    loss: f64,
    backward: f64,
    adam: f64,
    densify: f64,
}

/// Writes the logs of a run.
#[derive(Debug)]
pub(super) struct TrainingLogs {
    metrics: JsonlWriter,
    events: EventWriter,
    events_path: PathBuf,
    /// Steps between log lines; 0 for none.
    log_every: usize,
    /// Steps between evaluations on test views, each of which is logged; 0 for none.
    eval_every: usize,
    /// Times of the steps since the last line.
    times: MeanTimes,
}

impl TrainingLogs {
    /// Opens the logs of `run`, which begins at `beginning`.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub(super) fn open(run: &Path, beginning: &Beginning, output: &OutputConfig) -> Result<Self, TrainError> {
        let (metrics_path, events_path) = (RunPaths(run).metrics(), RunPaths(run).tensorboard());
        if !beginning.is_resumed && metrics_path.exists() {
            // left by a run that died before its first checkpoint
            std::fs::remove_file(&metrics_path).map_err(TrainError::in_file(&metrics_path))?;
        }
        let metrics = JsonlWriter::open(&metrics_path)?;
        // a run that died before its first checkpoint has left events too
        let events = if beginning.steps == 0 && !events_path.exists() {
            EventWriter::create(&events_path)
        } else {
            EventWriter::resume(&events_path, beginning.steps as u64 + 1)
        };
        let events = events.map_err(TrainError::in_file(&events_path))?;
        let (log_every, eval_every) = (output.log_every, output.eval_every);
        Ok(Self { metrics, events, events_path, log_every, eval_every, times: MeanTimes::default() })
    }

    /// Logs a step, if that is due, with the PSNR on test views, decibels, if they were evaluated after it.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub(super) fn after_step(&mut self, step: &TakenStep<'_>, test_psnr: Option<f64>) -> Result<(), TrainError> {
        self.times.add(step.report.times);
        if !step.is_due(self.log_every) && !step.is_due(self.eval_every) {
            return Ok(());
        }
        let line = MetricsLine::new(&step.report, &self.times.take(), step.clock.seconds(), test_psnr);
        self.metrics.append(&line)?;
        line.write_events(&mut self.events).map_err(TrainError::in_file(&self.events_path))
    }

    /// Makes all lines of `metrics.jsonl` durable.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub(super) fn sync(&mut self) -> Result<(), TrainError> {
        Ok(self.metrics.sync()?)
    }

    /// Writes the last events.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub(super) fn finish(mut self) -> Result<(), TrainError> {
        self.events.flush().map_err(TrainError::in_file(&self.events_path))
    }
}

impl MetricsLine {
    /// Returns the line of a step, with the mean times `t` of the steps since the line before.
    fn new(report: &StepReport, t: &StepTimes, seconds: f64, test_psnr: Option<f64>) -> Self {
        let ms = |d: std::time::Duration| (d.as_secs_f64() * 1e5).round() / 100.0;
        Self {
            step: report.step + 1,
            seconds: (seconds * 1e3).round() / 1e3,
            stage: report.stage,
            loss: report.loss,
            train_psnr: report.psnr,
            gaussians: report.primitives,
            test_psnr,
            milliseconds: Milliseconds {
                data: ms(t.data),
                deform: ms(t.deform),
                splat: ms(t.splat),
                loss: ms(t.loss),
                backward: ms(t.backward),
                adam: ms(t.adam),
                densify: ms(t.densify),
            },
        }
    }

    /// Writes the same values for TensorBoard.
    fn write_events(&self, events: &mut EventWriter) -> std::io::Result<()> {
        let step = self.step as u64;
        events.scalar(step, "train/loss", self.loss as f32)?;
        events.scalar(step, "train/psnr", self.train_psnr as f32)?;
        events.scalar(step, "train/gaussians", self.gaussians as f32)?;
        if let Some(p) = self.test_psnr {
            events.scalar(step, "test/psnr", p as f32)?;
        }
        Ok(())
    }
}
