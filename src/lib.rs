//! Deformable 3D Gaussians from rendered images of time-varying volumes.
//!
//! The modules follow the pipeline: `volume` (files, transfer functions, ray caster) -> `prepare` (a dataset) -> `data`
//! (images and cameras) -> `model` and `train` -> `eval` and `export`. Data flows one way; no module depends on a later
//! one. The binary's commands live in `cli`.

#![deny(clippy::print_stdout, clippy::print_stderr)] // they panic on a closed pipe; see `terminal`

#[macro_use]
pub mod terminal;

pub mod cli;
pub mod compare;
pub mod config;
mod csv;
pub mod data;
pub mod demo;
pub mod device;
pub mod draw;
pub mod durations;
pub mod edit;
pub mod eval;
pub mod export;
pub mod extend;
pub mod files;
pub mod log;
pub mod memory;
pub mod method;
pub mod metrics;
pub mod model;
pub mod name;
mod nesting;
pub mod points;
pub mod prepare;
pub mod process;
pub mod program;
mod registry;
pub mod report;
pub mod rng;
pub mod run;
pub mod segment;
pub mod shell;
pub mod sweep;
pub mod tensors;
pub mod track;
pub mod train;
pub mod versioned;
#[cfg(feature = "view")]
pub mod view;
pub mod volume;
pub mod words;

/// The tensor library used in this crate's signatures, re-exported in its exact version.
pub use burn;

/// Runs the program: parses the command line, runs the command and prints any error. The binary does nothing else; a
/// custom program calls this after registering its extensions, see [`extend`].
#[must_use]
pub fn main() -> std::process::ExitCode {
    memory::keep_freed_pages();
    method::add_sections();
    process::report_file_limits();
    let command = cli::Cli::read();
    let started = process::start_threads().map_err(cli::CliError::failure);
    let outcome = started.and_then(|()| command.run());
    let printed = terminal::finish().map_err(|e| cli::CliError::failure(format!("standard output: {e}")));
    match outcome.and(printed) {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(error) => {
            errln!("error: {error}");
            std::process::ExitCode::from(error.code())
        }
    }
}
