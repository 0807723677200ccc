//! Time-varying volumes and the images made of them: readers of volume files, transfer functions and a ray caster
//! ([`volume`]), datasets of posed images ([`data`]), and the way from one to the other ([`prepare`]).

#![deny(clippy::print_stdout, clippy::print_stderr)] // they panic on a closed pipe; see `volseggs_base::terminal`

#[macro_use]
extern crate volseggs_base;

pub mod data;
pub mod prepare;
pub mod volume;

use volseggs_base::{draw, files, memory, name, nesting, points, registry, rng, tensors, user_error, versioned, words};
