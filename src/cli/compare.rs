//! `volseggs compare`

use super::{CliError, print_json};
use crate::compare::metric::default_columns;
use crate::compare::runs::from_folders;
use crate::compare::write::replace_report;
use clap::Args;
use std::path::PathBuf;
use std::sync::LazyLock;

/// The metrics of a table unless told otherwise.
static METRICS: LazyLock<String> =
    LazyLock::new(|| default_columns(&[], &["fps", "training_minutes", "model_mib"]).join(","));

/// Compare runs: a table over seeds, learning curves, pictures with error maps.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs compare checkpoints/l1 checkpoints/l2\n  volseggs compare checkpoints/*-seed? --metrics psnr,ssim,fps --out comparison\n\nRuns must have been evaluated (`volseggs eval RUN`). Runs that differ only in the seed share a row, with mean and\ndeviation; differences are relative to the first run."
)]
pub struct CompareArgs {
    /// Folders of runs; the first is the baseline.
    #[arg(required = true, value_name = "RUN")]
    runs: Vec<PathBuf>,
    /// Metrics to report.
    #[arg(long, value_delimiter = ',', default_value = METRICS.as_str())]
    metrics: Vec<String>,
    /// Folder for report.html, report.md, table.tex, results.csv, results.json and tensorboard/; if not given, only the
    /// table is printed.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object on standard output.
    #[arg(long)]
    json: bool,
}

impl CompareArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let set = from_folders(&self.runs, &self.metrics).map_err(CliError::input)?;
        let text = match &self.out {
            Some(out) => replace_report(out, &set)?,
            None => crate::compare::write::table_text(&set),
        };
        if self.json {
            return print_json(&set);
        }
        out!("{text}");
        if let Some(out) = &self.out {
            errln!("report: {}", out.join("report.html").display());
        }
        Ok(())
    }
}
