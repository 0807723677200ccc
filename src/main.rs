//! Parses the command line, dispatches, prints errors; nothing else.

use clap::Parser;
use std::process::ExitCode;

/// Training allocates and frees tensors of megabytes every step; the system's allocator would hand their
/// pages back to the kernel each time.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    match volseggs::cli::Cli::parse().run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.code())
        }
    }
}
