//! Every file reader against damaged files: no panic, no hang, no memory beyond what the file's size explains.
//!
//! Each reader has a few valid files, made here by the library's own writers or by hand, and damages them: bits,
//! blocks, numbers, words of its format, splices of two. What a reader accepts is then used as the program would use
//! it. Checksums are corrected after the damage (PNG, this project's tensor files), so that the parsers behind them are
//! reached.
//!
//! `cargo test --test fuzz` gives each reader 2000 cases or 0.6 seconds, whichever ends first. For longer runs:
//!
//! ```text
//! VOLSEGGS_FUZZ_CASES=1000000 VOLSEGGS_FUZZ_SECONDS=1200 cargo test --release --test fuzz -- --nocapture
//! ```
//!
//! `VOLSEGGS_FUZZ_READER=nrrd` selects the readers with that text in their names, `VOLSEGGS_FUZZ_SEED=7` different
//! damage, and `VOLSEGGS_FUZZ_CASE=123` a single case of a report, with the message of its panic. Cases that fail are
//! kept in `volseggs-fuzz` in the system's folder for temporary files.
//!
//! A case runs on one thread, rayon's tasks included, which is counted and watched: it may take at most 2 seconds, and
//! at most the memory that [`driver::Target`] states for the reader. A reader that recurses without end would take the
//! whole process down; see `nesting`.
#![allow(clippy::unwrap_used)]

mod config;
mod counting;
mod data;
mod driver;
mod masks;
mod mutate;
mod names;
mod nesting;
mod runs;
mod sweeps;
mod tensors;
mod transfer;
mod views;
mod volumes;
mod weights;

#[global_allocator]
static ALLOCATOR: counting::Counting = counting::Counting;
