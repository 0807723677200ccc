//! The command line: one file a command, each turning arguments into a library call.

mod compare;
mod config;
mod demo;
mod doctor;
mod edit;
mod error;
mod eval;
mod eval_segments;
mod export;
mod inspect;
mod inspect_volume;
mod prepare;
mod render;
mod run_folder;
mod segment;
mod shown;
mod sweep;
mod track;
mod train;

pub use error::CliError;

use crate::device::DeviceName;
use burn::tensor::Device;
use clap::{Args, Parser, Subcommand};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Deformable 3D Gaussians from rendered images of time-varying volumes.
#[derive(Debug, Parser)]
#[command(name = "volseggs", version, about, max_term_width = 100)]
#[command(
    after_help = "Start here:\n  volseggs demo\n  volseggs prepare --volume 'run/*.nrrd' --transfer-function fire --out DATASET\n  volseggs train --data DATASET --config quick --out RUN\n  volseggs eval RUN\n  volseggs segment coarse RUN\n  volseggs track RUN --segment red\n  volseggs edit isolate RUN --segment red\n  volseggs render RUN --path orbit --out FRAMES"
)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::DemoArgs),
    Prepare(Box<prepare::PrepareArgs>),
    Train(train::TrainArgs),
    Eval(Box<eval::EvalArgs>),
    Segment(segment::SegmentArgs),
    Track(track::TrackArgs),
    Edit(edit::EditArgs),
    Render(render::RenderArgs),
    Export(export::ExportArgs),
    Inspect(inspect::InspectArgs),
    Sweep(Box<sweep::SweepArgs>),
    Compare(compare::CompareArgs),
    Config(config::ConfigArgs),
    Doctor(doctor::DoctorArgs),
}

/// Options that every command has.
#[derive(Debug, Clone, Args)]
pub struct Common {
    /// Device to run on: flex, ndarray or wgpu (and cuda, tch if compiled in; see `volseggs doctor`).
    #[arg(long, default_value = "flex", value_name = "NAME")]
    pub device: String,
    /// Print one JSON object on standard output; logs stay on standard error.
    #[arg(long)]
    pub json: bool,
}

impl Common {
    fn device(&self) -> Result<(DeviceName, Device), CliError> {
        let name: DeviceName = self.device.parse().map_err(CliError::input)?;
        Ok((name, name.open().map_err(CliError::input)?))
    }
}

/// A flag that Ctrl-C or SIGTERM raises, saying `message`; asked twice, the program ends at once.
fn stop_flag(message: &'static str) -> Result<Arc<AtomicBool>, CliError> {
    flag(message, true)
}

/// The same for a program that others ask: batch systems send SIGTERM to it and to its parent, which passes it on, so
/// that being asked again says nothing.
fn patient_stop_flag(message: &'static str) -> Result<Arc<AtomicBool>, CliError> {
    flag(message, false)
}

fn flag(message: &'static str, hasty: bool) -> Result<Arc<AtomicBool>, CliError> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || match flag.swap(true, Ordering::Relaxed) {
        true if hasty => std::process::exit(1),
        true => {}
        false => eprintln!("{message}"),
    })
    .map_err(CliError::failure)?;
    Ok(stop)
}

/// Prints a value as one JSON object on standard output.
fn print_json(value: &impl serde::Serialize) -> Result<(), CliError> {
    let text = serde_json::to_string_pretty(value).map_err(CliError::failure)?;
    println!("{text}");
    Ok(())
}

impl Cli {
    /// Runs the command.
    ///
    /// # Errors
    /// A message for the terminal, with the exit code.
    pub fn run(self) -> Result<(), CliError> {
        match self.command {
            Command::Demo(args) => args.run(),
            Command::Prepare(args) => args.run(),
            Command::Train(args) => args.run(),
            Command::Eval(args) => args.run(),
            Command::Segment(args) => args.run(),
            Command::Track(args) => args.run(),
            Command::Edit(args) => args.run(),
            Command::Render(args) => args.run(),
            Command::Export(args) => args.run(),
            Command::Inspect(args) => args.run(),
            Command::Sweep(args) => args.run(),
            Command::Compare(args) => args.run(),
            Command::Config(args) => args.run(),
            Command::Doctor(args) => args.run(),
        }
    }
}
