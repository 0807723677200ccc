//! Segments of a scene: found by colour, by masks and by clicks ([`segment`]), followed through time ([`track`]) and
//! edited ([`edit`]).

#![deny(clippy::print_stdout, clippy::print_stderr)] // they panic on a closed pipe; see `volseggs_base::terminal`

pub mod edit;
pub mod segment;
pub mod track;

use volseggs_base::{csv, draw, files, memory, name, points, registry, rng, tensors, versioned, words};
use volseggs_core::{config, device, export, model, train};
use volseggs_volume::{data, volume};
