//! Deformable 3D Gaussians from rendered images of time-varying volumes.
//!
//! The modules follow the pipeline: `volume` (files, transfer functions, ray caster) -> `prepare` (a dataset) -> `data`
//! (images and cameras) -> `model` and `train` -> `eval` and `export`. Data flows one way; no module depends on a later
//! one. The binary's commands live in `cli`.

#![deny(clippy::print_stdout, clippy::print_stderr)] // they panic on a closed pipe; see `terminal`

#[macro_use]
extern crate volseggs_base;

pub mod cli;
pub mod compare;
pub mod demo;
pub mod eval;
pub mod extend;
pub mod method;
pub mod run;
pub mod sweep;
#[cfg(feature = "view")]
pub mod view;

use volseggs_base::{csv, nesting, registry, terminal};
pub use volseggs_base::{
    draw, durations, files, log, memory, name, points, process, program, report, rng, shell, tensors, versioned, words,
};
pub use volseggs_core::{config, device, export, metrics, model, train};
pub use volseggs_segment::{edit, segment, track};
pub use volseggs_volume::{data, prepare, volume};

/// The tensor library used in this crate's signatures, re-exported in its exact version.
pub use burn;

/// Runs the program: parses the command line, runs the command and prints any error. The binary does nothing else; a
/// custom program calls this after registering its extensions, see [`extend`].
#[must_use]
pub fn main() -> std::process::ExitCode {
    memory::keep_freed_pages();
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
