//! Sweeps on a real Slurm of one node, which the tests start. Needs the programs of Slurm and munge (Debian: slurm-wlm,
//! munge) and is skipped without them.
#![cfg(target_os = "linux")]

mod arrays;
mod cluster;
mod sweeps;
