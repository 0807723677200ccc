//! The program without extensions; everything is in the library.

use std::process::ExitCode;

/// Training allocates and frees megabytes of tensors every step; the system allocator would return their pages to the
/// kernel each time.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    volseggs::main()
}
