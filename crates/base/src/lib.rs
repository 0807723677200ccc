//! What every part of volseggs uses and none of it knows volumes, models or devices: files that are written whole or not
//! at all, names, words for messages, tables, plots, reports, logs, random numbers, and algorithms on points.

#![deny(clippy::print_stdout, clippy::print_stderr)] // they panic on a closed pipe; see `terminal`

#[macro_use]
pub mod terminal;

pub mod csv;
pub mod draw;
pub mod durations;
pub mod files;
pub mod log;
pub mod memory;
pub mod name;
pub mod nesting;
pub mod points;
pub mod process;
pub mod program;
pub mod registry;
pub mod report;
pub mod rng;
pub mod shell;
pub mod tensors;
pub mod user_error;
pub mod versioned;
pub mod words;
