//! Deformable 3D Gaussians: their configuration, the burn modules ([`model`]), training ([`train`]), metrics of images
//! ([`metrics`]) and files for other programs ([`export`]).

#![deny(clippy::print_stdout, clippy::print_stderr)] // they panic on a closed pipe; see `volseggs_base::terminal`

#[macro_use]
extern crate volseggs_base;

pub mod config;
pub mod device;
pub mod export;
pub mod metrics;
pub mod model;
pub mod train;

#[cfg(test)]
use volseggs_base::points;
use volseggs_base::{
    files, log, memory, nesting, program, registry, rng, shell, tensors, user_error, versioned, words,
};
use volseggs_volume::{data, volume};
