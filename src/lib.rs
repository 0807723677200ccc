//! Deformable 3D Gaussians from rendered images of time-varying volumes.
//!
//! The pipeline is the layout: `volume` (files, transfer functions, ray caster) -> `prepare` (a dataset) ->
//! `data` (images and cameras) -> `model` and `train` -> `eval` and
//! `export`. Data flows one way; no folder reaches back. The binary's commands live in `cli`.

#![deny(clippy::print_stdout, clippy::print_stderr)] // they panic where nobody reads; see `terminal`

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
#[cfg(feature = "view")]
pub mod view;
pub mod volume;
pub mod words;

/// The library of tensors that every signature here speaks of, in its version.
pub use burn;

/// The program: parses the command line, runs the command, prints an error. All that the binary does; a program of
/// your own calls it after it has registered its extensions, see [`extend`].
#[must_use]
pub fn main() -> std::process::ExitCode {
    let outcome = <cli::Cli as clap::Parser>::parse().run();
    let printed = terminal::finish().map_err(|e| cli::CliError::failure(format!("standard output: {e}")));
    match outcome.and(printed) {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(error) => {
            errln!("error: {error}");
            std::process::ExitCode::from(error.code())
        }
    }
}
