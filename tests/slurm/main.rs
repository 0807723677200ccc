//! Sweeps on a real Slurm of one node, which the tests start. Needs the programs of Slurm and munge (Debian: slurm-wlm,
//! munge); skipped with a line without them, unless `VOLSEGGS_REQUIRE_SLURM` is set.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used)]

mod arrays;
mod cluster;
#[path = "../common/mod.rs"]
mod common;
mod sweeps;
