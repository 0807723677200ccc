//! Progress of a run on standard error.

use super::TakenStep;
use crate::log::progress::{ProgressLines, step_bar};
use indicatif::ProgressBar;
use std::io::IsTerminal;

/// Shows the progress of a run: as a bar on a terminal, as lines in a log.
#[derive(Debug)]
pub(super) struct ProgressReporter {
    /// Created at the first step: an observer may print before it.
    bar: Option<ProgressBar>,
    lines: ProgressLines,
    on_terminal: bool,
    /// Steps taken before this process.
    first: usize,
    /// Steps of the whole training.
    total: usize,
    /// Steps between evaluations on test views, each of which is reported; 0 for none.
    eval_every: usize,
    /// Exponential moving average of the PSNR of the training views, decibels.
    train_psnr: Option<f64>,
}

impl ProgressReporter {
    /// Returns the progress of a training of `total` steps, from step `first` up to `limit` in this process.
    pub(super) fn new(first: usize, limit: usize, total: usize, eval_every: usize) -> Self {
        let on_terminal = std::io::stderr().is_terminal();
        Self {
            bar: None,
            lines: ProgressLines::new(first, limit),
            on_terminal,
            first,
            total,
            eval_every,
            train_psnr: None,
        }
    }

    /// Shows the bar.
    pub(super) fn before_step(&mut self) {
        self.bar.get_or_insert_with(|| step_bar(self.total, self.first));
    }

    /// Shows a step, and the last PSNR on test views.
    pub(super) fn after_step(&mut self, step: &TakenStep<'_>, test_psnr: Option<f64>) {
        let (report, done, here) = (step.report, step.steps(), step.clock.seconds_here());
        let train_psnr = self.train_psnr.map_or(report.psnr, |mean| 0.98 * mean + 0.02 * report.psnr);
        self.train_psnr = Some(train_psnr);
        let test = test_psnr.map(|p| format!(" test {p:.2} dB")).unwrap_or_default();
        let count = if report.primitives > 0 { format!(" N={}", report.primitives) } else { String::new() };
        let text = format!("{} loss {:.5} train {train_psnr:.2} dB{test}{count}", report.stage, report.loss);
        if !self.on_terminal && (self.lines.is_due(done, here) || step.is_due(self.eval_every)) {
            let left = self.lines.left(done, here, step.clock.seconds_left());
            errln!("{done}/{} {:.0} s{left} {text}", self.total, step.clock.seconds());
        }
        if let Some(bar) = &self.bar {
            bar.set_position(done as u64);
            bar.set_message(text);
        }
    }

    /// Says that the training is paused.
    pub(super) fn pause_begins(&self, steps: usize) {
        match &self.bar {
            Some(bar) if self.on_terminal => bar.set_message("paused"),
            _ => errln!("paused after {steps} steps"),
        }
    }

    /// Leaves the pause out of the time left.
    pub(super) fn pause_ends(&self) {
        self.bar.iter().for_each(ProgressBar::reset_eta);
    }

    /// Leaves the bar as it is.
    pub(super) fn finish(&self) {
        self.bar.iter().for_each(ProgressBar::abandon);
    }
}
