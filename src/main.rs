//! Parses the command line, dispatches, prints errors; nothing else.

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    match volseggs::cli::Cli::parse().run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.code())
        }
    }
}
