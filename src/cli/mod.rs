//! The command line: one file per command, each turning arguments into a library call.

mod camera;
mod compare;
mod completions;
mod config;
mod data;
mod demo;
mod doctor;
mod edit;
mod error;
mod eval;
mod eval_segments;
mod export;
mod inspect;
mod inspect_volume;
mod lpips;
mod pack;
mod prepare;
mod prepare_inputs;
mod raycast;
mod relocate;
mod render;
mod segment;
#[cfg(feature = "view")]
mod serving;
mod settings;
mod shown;
mod sweep;
mod time;
mod track;
mod train;
mod values;
#[cfg(feature = "view")]
mod view;
#[cfg(feature = "view")]
mod watch;

#[cfg(test)]
#[path = "help_tests.rs"]
mod help_tests;

pub use error::CliError;

use crate::device::DeviceName;
use crate::files::LockDuration;
use crate::memory::{Bytes, MemoryBudget};
use crate::run::OpenRun;
use crate::words::plain;
use burn::tensor::Device;
use clap::{ArgMatches, Args, CommandFactory, FromArgMatches, Parser, Subcommand};
use std::ffi::OsString;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Deformable 3D Gaussians from rendered images of time-varying volumes.
#[derive(Debug, Parser)]
#[command(name = "volseggs", version, about, max_term_width = 100)]
#[command(
    after_help = "Start here:\n  volseggs demo\n  volseggs prepare --volume 'run/*.nrrd' --transfer-function fire --out DATASET\n  volseggs train --data DATASET --config quick --out RUN\n  volseggs eval RUN\n  volseggs segment coarse RUN\n  volseggs track RUN --segment red\n  volseggs edit isolate RUN --segment red\n  volseggs render RUN --path orbit --out FRAMES"
)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Maximum memory to use, such as 12G; the free memory of the system if not given.
    #[arg(long, global = true, value_name = "SIZE", allow_hyphen_values = true)]
    memory: Option<Bytes>,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::DemoArgs),
    Prepare(Box<prepare::PrepareArgs>),
    Train(Box<train::TrainArgs>),
    Eval(Box<eval::EvalArgs>),
    Segment(segment::SegmentArgs),
    Track(track::TrackArgs),
    Edit(edit::EditArgs),
    Render(render::RenderArgs),
    #[cfg(feature = "view")]
    View(view::ViewCommand),
    Export(export::ExportArgs),
    Pack(pack::PackArgs),
    Relocate(relocate::RelocateArgs),
    Inspect(inspect::InspectArgs),
    Sweep(Box<sweep::SweepArgs>),
    Compare(compare::CompareArgs),
    Raycast(raycast::RaycastArgs),
    Config(config::ConfigArgs),
    Lpips(lpips::LpipsArgs),
    Doctor(doctor::DoctorArgs),
    Completions(completions::CompletionsArgs),
}

/// Options shared by all commands.
#[derive(Debug, Clone, Args)]
pub struct CommonArgs {
    /// Device to run on: flex, ndarray or wgpu (and cuda, tch if compiled in; see `volseggs doctor`).
    #[arg(long, default_value = "flex", value_name = "NAME")]
    pub device: String,
    /// Print one JSON object on standard output; logs stay on standard error.
    #[arg(long)]
    pub json: bool,
}

impl CommonArgs {
    fn device(&self) -> Result<(DeviceName, Device), CliError> {
        let name: DeviceName = self.device.parse().map_err(CliError::input)?;
        Ok((name, name.open().map_err(CliError::input)?))
    }

    /// Opens a run, or one of its checkpoints, for reading.
    fn open(&self, run: &Path) -> Result<OpenRun, CliError> {
        Ok(OpenRun::open(run, &self.device()?.1)?)
    }

    /// Opens a run for writing, see [`OpenRun::open_to_write`].
    fn open_to_write(&self, run: &Path, work: LockDuration) -> Result<OpenRun, CliError> {
        Ok(OpenRun::open_to_write(run, &self.device()?.1, &command_line(), work)?)
    }
}

/// The command line as called, shown to users who find a run locked.
fn command_line() -> String {
    let words = std::env::args_os().skip(1).map(|w| w.to_string_lossy().into_owned());
    let mut line = std::iter::once("volseggs".to_owned()).chain(words).collect::<Vec<_>>().join(" ");
    if let Some((end, _)) = line.char_indices().nth(200) {
        line.truncate(end);
        line.push_str("...");
    }
    line
}

/// Signals within this time count as one request: `timeout` and batch systems signal both a process and its group.
const ONE_REQUEST: Duration = Duration::from_secs(1);

/// What a second request to stop does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum OnSecondSignal {
    /// Ends the program at once.
    Exit,
    /// Nothing: batch systems send SIGTERM to a process and to its parent, which passes it on.
    Ignore,
}

/// Returns a flag that is raised by Ctrl-C, SIGTERM or a closed terminal (SIGHUP), which prints `message`; another
/// request after that ends the program at once.
fn stop_flag(message: &'static str) -> Result<Arc<AtomicBool>, CliError> {
    stop_flag_with(message, OnSecondSignal::Exit)
}

/// As [`stop_flag`], with a choice of what another request does.
fn stop_flag_with(message: &'static str, second: OnSecondSignal) -> Result<Arc<AtomicBool>, CliError> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    let mut first: Option<Instant> = None;
    ctrlc::set_handler(move || {
        flag.store(true, Ordering::Relaxed);
        match first {
            Some(first) if second == OnSecondSignal::Exit && first.elapsed() > ONE_REQUEST => std::process::exit(1),
            Some(_) => {}
            None => {
                first = Some(Instant::now());
                errln!("{message}");
            }
        }
    })
    .map_err(CliError::failure)?;
    Ok(stop)
}

/// Prints a value as one JSON object on standard output.
fn print_json(value: &impl serde::Serialize) -> Result<(), CliError> {
    let text = serde_json::to_string_pretty(value).map_err(CliError::failure)?;
    outln!("{text}");
    Ok(())
}

/// Lets every option take a negative number, so that its own parser says what is wrong with it; otherwise `-1` would be
/// reported as an unknown option.
fn with_negative_values(command: clap::Command) -> clap::Command {
    let takes = |arg: &clap::Arg| arg.get_action().takes_values() && !arg.is_positional();
    command
        .mut_args(|arg| if takes(&arg) { arg.allow_negative_numbers(true) } else { arg })
        .mut_subcommands(with_negative_values)
}

impl Cli {
    /// Parses the command line. A wrong one, a request for help or for the version ends the program with a message.
    pub fn read() -> Self {
        Self::from_line(std::env::args_os()).unwrap_or_else(|error| {
            let text = error.render().to_string();
            let words = plain(&text);
            if words == text.trim_end() {
                error.exit();
            }
            errln!("{words}");
            std::process::exit(error.exit_code())
        })
    }

    /// Parses a command line that begins with the name of the program.
    ///
    /// # Errors
    /// As for [`Cli::matches`].
    pub fn from_line<T: Into<OsString> + Clone>(line: impl IntoIterator<Item = T>) -> clap::error::Result<Self> {
        Self::from_arg_matches_mut(&mut Self::matches(line)?).map_err(|e| e.format(&mut Self::command()))
    }

    /// The arguments of a command line that begins with the name of the program.
    ///
    /// # Errors
    /// A wrong command line, or a request for help or for the version.
    pub fn matches<T: Into<OsString> + Clone>(line: impl IntoIterator<Item = T>) -> clap::error::Result<ArgMatches> {
        with_negative_values(Self::command()).try_get_matches_from(line)
    }

    /// Runs the command.
    ///
    /// # Errors
    /// A message for the terminal, with the exit code.
    pub fn run(self) -> Result<(), CliError> {
        if let Some(bytes) = self.memory {
            MemoryBudget::allow(bytes);
        }
        match self.command {
            Command::Demo(args) => args.run(),
            Command::Prepare(args) => args.run(),
            Command::Train(args) => args.run(),
            Command::Eval(args) => args.run(),
            Command::Segment(args) => args.run(),
            Command::Track(args) => args.run(),
            Command::Edit(args) => args.run(),
            Command::Render(args) => args.run(),
            #[cfg(feature = "view")]
            Command::View(args) => args.run(),
            Command::Export(args) => args.run(),
            Command::Pack(args) => args.run(),
            Command::Relocate(args) => args.run(),
            Command::Inspect(args) => args.run(),
            Command::Sweep(args) => args.run(),
            Command::Compare(args) => args.run(),
            Command::Raycast(args) => args.run(),
            Command::Config(args) => args.run(),
            Command::Lpips(args) => args.run(),
            Command::Doctor(args) => args.run(),
            Command::Completions(args) => args.run(),
        }
    }
}
