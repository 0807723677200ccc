//! `volseggs demo`

use super::{CliError, CommonArgs, print_json, stop_flag};
use crate::demo::{DemoError, DemoOptions, demo};
use crate::shell;
use clap::Args;
use serde_json::json;
use std::time::Instant;

/// Run the whole pipeline on a built-in scene, in minutes: prepare, train, evaluate and write a report.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs demo\n  volseggs demo --scene vortices --out checkpoints/vortices\n  volseggs demo --set stages.joint_steps=6000 --out checkpoints/longer\n\nAfter Ctrl-C, the same command resumes where it stopped."
)]
pub struct DemoArgs {
    #[command(flatten)]
    options: DemoOptions,
    #[command(flatten)]
    common: CommonArgs,
}

impl DemoArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (name, device) = self.common.device()?;
        let stop = stop_flag("stopping")?;
        let started = Instant::now();
        let outcome = demo(&self.options, (&name.to_string(), &device), &stop).map_err(|e| match e {
            DemoError::Input(_) => CliError::input(e),
            DemoError::Train(e) => e.into(),
            e => CliError::failure(e),
        })?;
        let s = &outcome.evaluation.summary;
        let quality = s
            .metrics
            .shown_by_default()
            .into_iter()
            .map(|(shown, v)| format!("{} {}", shown.short, shown.with_unit(v)));
        errln!(
            "{} on {} test views, {:.0} s in total\nopen {} in a browser; fly through the \
             scene with `volseggs view {}`",
            quality.collect::<Vec<_>>().join(", "),
            s.views,
            started.elapsed().as_secs_f64(),
            outcome.report.display(),
            shell::path(&self.options.out.join("run"))
        );
        if self.common.json {
            let stages: serde_json::Map<String, serde_json::Value> =
                outcome.stages.iter().map(|(name, seconds)| (name.clone(), json!(seconds))).collect();
            print_json(&json!({ "report": outcome.report.to_string_lossy(), "stages_seconds": stages, "metrics": s }))?;
        }
        Ok(())
    }
}
