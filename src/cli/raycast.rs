//! `volseggs raycast`

use super::values::{count, finite_f32};
use super::{CliError, CommonArgs, print_json};
use crate::data::dataset::read_views;
use crate::data::{Normalisation, SplitName};
use crate::program;
use crate::run::rendering::{PreparedDataset, VolumeCosts, draw_run, table};
use crate::run::{AnyRun, dataset_of};
use crate::volume::series::{Series, SeriesOptions};
use clap::Args;
use serde_json::json;
use std::ffi::OsString;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Instant;

/// Measure the cost of drawing: ray casting the volumes that a run's images were made from, compared with the run.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs raycast checkpoints/first --volume 'run/*.nrrd'\n  volseggs raycast checkpoints/first --volume run --steps 10 --views 50 --json\n\nPrints a table: size of the data, memory, time before anything is drawn, time to load a step, time to draw a view. Views are\nthose of the dataset's test split, drawn as `prepare` drew them. Each side runs in its own process. Steps are read from\ndisk, bypassing the system's cache where that is possible (Linux). Volumes are drawn on the CPU, whatever the device, and\nGPU memory is not counted."
)]
pub struct RaycastArgs {
    /// Folder of the run.
    run: PathBuf,
    /// The volumes that its dataset was made from: files in order of time, a folder, a glob in quotes, or one 4D file.
    #[arg(long, value_name = "PATH", num_args = 1.., required = true)]
    volume: Vec<String>,
    /// The array that was read from .vti files, see `volseggs prepare`.
    #[arg(long, value_name = "NAME")]
    variable: Option<String>,
    /// Dataset folder, if it has moved since training.
    #[arg(long, value_name = "DATASET")]
    data: Option<PathBuf>,
    /// Number of steps to load, evenly spaced.
    #[arg(long, default_value_t = 5, value_name = "N", value_parser = count)]
    steps: usize,
    /// Number of test views to draw, evenly spaced and distributed over these steps.
    #[arg(long, default_value_t = 20, value_name = "N", value_parser = count)]
    views: usize,
    /// Accept a series with missing numbers.
    #[arg(long)]
    allow_gaps: bool,
    /// Value that replaces NaN and infinite voxels.
    #[arg(long, value_name = "VALUE", value_parser = finite_f32, allow_hyphen_values = true)]
    nan: Option<f32>,
    /// Measure only the volumes, at images reduced by this factor, and print JSON; this command starts itself with this
    /// option.
    #[arg(long, hide = true, value_name = "FACTOR")]
    volumes_alone: Option<u32>,
    #[command(flatten)]
    common: CommonArgs,
}

impl RaycastArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let data = match &self.data {
            Some(folder) => folder.clone(),
            None => dataset_of(&self.run)?,
        };
        // an origin that changes is no matter for the cost
        let options = SeriesOptions {
            nan_as: self.nan,
            allow_gaps: self.allow_gaps,
            ignore_origin: true,
            variable: self.variable.clone(),
            ..SeriesOptions::default()
        };
        let (prepared, series) = (PreparedDataset::open(&data)?, Series::open(&self.volume, &options)?);
        // invalid input is reported before anything is measured
        prepared.check(&series)?;
        let views =
            |downscale, normalisation| read_views(&data, SplitName::Test, downscale, Some(self.views), normalisation);
        if let Some(downscale) = self.volumes_alone {
            let views = views(downscale, &Normalisation::NONE)?;
            return print_json(&prepared.draw_volumes(&series, &views, self.steps)?);
        }
        series.notes().iter().for_each(|note| errln!("note: {note}"));
        let (_, device) = self.common.device()?;
        let started = Instant::now();
        let run = AnyRun::open_any(&self.run, &device)?;
        let load_seconds = started.elapsed().as_secs_f64();
        let downscale = run.config.data.downscale;
        let volumes = volumes_alone(downscale)?;
        let run = draw_run(&run, &views(downscale, &run.record.normalisation)?, &data, load_seconds)?;
        if self.common.json {
            return print_json(&json!({ "volumes": volumes, "run": run }));
        }
        out!("{}", table(&volumes, &run));
        Ok(())
    }
}

/// The cost of the volumes, measured in a process started like this one, since peak memory is counted per process.
fn volumes_alone(downscale: u32) -> Result<VolumeCosts, CliError> {
    let mut command = Command::new(program::executable());
    let mut given: Vec<OsString> = std::env::args_os().skip(1).collect();
    // right after the subcommand, as options may precede it, and the arguments may end in `-- RUN`
    let at = given.iter().position(|argument| argument == "raycast").map_or(0, |at| at + 1);
    given.splice(at..at, ["--volumes-alone".into(), downscale.to_string().into()]);
    command.args(given);
    let output = command.stdin(Stdio::null()).output().map_err(CliError::failure)?;
    if !output.status.success() {
        let message = String::from_utf8_lossy(&output.stderr);
        let code = output.status.code().and_then(|code| u8::try_from(code).ok()).unwrap_or(1);
        return Err(CliError::with_code(message.trim().trim_start_matches("error: "), code));
    }
    serde_json::from_slice(&output.stdout).map_err(CliError::failure)
}
