//! The program without extensions of its own; all of it is in the library.

use std::process::ExitCode;

/// Training allocates and frees tensors of megabytes every step; the system's allocator would hand their
/// pages back to the kernel each time.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    volseggs::main()
}
