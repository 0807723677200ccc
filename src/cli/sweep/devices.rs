//! `volseggs sweep devices`: the same training on every device.

use super::CliError;
use crate::cli::config::ConfigSource;
use crate::cli::values::count;
use crate::cli::{print_json, stop_flag};
use crate::device::DeviceName;
use crate::sweep::devices::{DeviceComparison, compare_devices};
use crate::train::open_dataset;
use clap::Args;
use std::path::PathBuf;

/// Train the same configuration and seed on every device, and report speed, quality and how far apart they end.
#[derive(Debug, Args)]
pub(super) struct DevicesArgs {
    /// Dataset folder.
    #[arg(long, value_name = "DATASET")]
    data: PathBuf,
    #[command(flatten)]
    config: ConfigSource,
    /// Devices, the first being the reference; if not given, all that work on this machine.
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    devices: Vec<String>,
    /// Steps between two comparisons of the parameters.
    #[arg(long, default_value_t = 50, value_name = "STEPS", value_parser = count)]
    every: usize,
    /// Print one JSON object on standard output.
    #[arg(long)]
    json: bool,
}

impl DevicesArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let devices = if self.devices.is_empty() {
            let starts = |d: &DeviceName| match d.open() {
                Ok(_) => true,
                Err(error) => {
                    errln!("skipped: {error}");
                    false
                }
            };
            DeviceName::all().into_iter().filter(starts).collect()
        } else {
            self.devices.iter().map(|d| d.parse()).collect::<Result<Vec<DeviceName>, _>>().map_err(CliError::input)?
        };
        let config = self.config.resolve()?.value;
        let dataset = open_dataset(&self.data, &config)?;
        let stop = stop_flag("stopping after these steps")?;
        let found = compare_devices(&config, &dataset, &devices, self.every, &stop, |what| errln!("{what}"))?;
        if self.json {
            return print_json(&found);
        }
        out!("{}", markdown(&found));
        Ok(())
    }
}

fn markdown(found: &DeviceComparison) -> String {
    let mut out = format!("After {} steps:\n\n", found.steps);
    out += "| device | step, ms | PSNR, dB | parameters compared with the first |\n|---|--:|--:|---|\n";
    for d in &found.devices {
        let drift = d.drift.last().map_or("the reference".to_owned(), ToString::to_string);
        out += &format!("| {} | {:.1} | {:.3} | {drift} |\n", d.device, d.step_milliseconds, d.psnr);
    }
    out
}
