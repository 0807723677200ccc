//! Files for other programs, as `export` writes them, in the run folder.

use super::board::Reporter;
use crate::export::exporters::{Exporter, LabelWriter};
use crate::run::export::{ExportOutput, ExportRecord, SplatPlan, write_labels, write_splats};
use crate::run::labels::{LabelPlan, RunLabels};
use crate::run::selection::Selection;
use crate::run::{OpenRun, RunError};
use std::path::Path;

/// What to write.
pub struct Export<'a> {
    /// Format of the files.
    pub format: &'static Exporter,
    /// Segments to write; all if empty.
    pub segments: &'a [String],
    /// Whether the edits apply.
    pub edited: bool,
    /// Times in [0, 1].
    pub times: &'a [f64],
    /// Whether to write a folder with a file for each time, instead of one file.
    pub many: bool,
}

impl Export<'_> {
    /// Writes it, and returns a description of what was written; `None` if `report` stopped it.
    ///
    /// # Errors
    /// As the functions of [`crate::run`].
    pub fn write(&self, run: &OpenRun, report: &mut Reporter) -> Result<Option<String>, RunError> {
        match self.format.labels() {
            None => self.splats(run, report),
            Some(write) => self.labels(run, write, report),
        }
    }

    fn splats(&self, run: &OpenRun, report: &mut Reporter) -> Result<Option<String>, RunError> {
        let shown = Selection::open(run, self.segments, self.edited)?;
        let output = self.place(&run.paths().exported(), "scene")?;
        let mut done = 0;
        let plan = SplatPlan::new(run, self.format);
        let refit_steps = plan.refit_steps();
        let unit = if refit_steps > 0 { "steps" } else { "times" };
        let all = (refit_steps + 1) * self.times.len();
        let one_more = || {
            done += 1;
            report.report(unit, done, all, None)
        };
        let Some(written) = write_splats(run, &shown, self.times, &output, &plan, one_more)? else {
            return Ok(None);
        };
        let message = format!("{} Gaussians: {}", written.gaussians, output.path().display());
        let coordinates = Some(plan.units);
        output.finish(&ExportRecord { refit_steps, coordinates, ..self.record(run, self.segments) }, &[])?;
        Ok(Some(message))
    }

    fn labels(&self, run: &OpenRun, write: LabelWriter, report: &mut Reporter) -> Result<Option<String>, RunError> {
        let edited = self.edited;
        let labels =
            RunLabels::new(run, &LabelPlan { segments: self.segments.to_vec(), edited, ..LabelPlan::default() })?;
        let output = self.place(&run.paths().labels(), "labels")?;
        for (i, &time) in self.times.iter().enumerate() {
            write_labels(&output.paths_of(i).0, &labels, &labels.labels_at(time)?.ids, edited, write, None)?;
            // after the last time there is nothing left to cancel
            if !report.report("times", i + 1, self.times.len(), None) && i + 1 < self.times.len() {
                return Ok(None);
            }
        }
        let message = format!("labels of {}: {}", labels.names.join(", "), output.path().display());
        output.finish(&self.record(run, &labels.names), &[])?;
        Ok(Some(message))
    }

    fn place(&self, folder: &Path, name: &str) -> Result<ExportOutput, RunError> {
        ExportOutput::within(folder, name, self.format.extension, self.many, &[])
    }

    fn record<'a>(&'a self, run: &'a OpenRun, segments: &'a [String]) -> ExportRecord<'a> {
        ExportRecord::new(run, self.format.extension, self.times, self.edited, segments)
    }
}
