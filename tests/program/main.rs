//! The program as a whole: its commands one after the other, as a user or a batch system calls them. One binary for all
//! tests, as each further one costs a link of the whole tree.
#![allow(clippy::unwrap_used)]

mod appearance;
mod bad_input;
mod commands;
#[path = "../common/mod.rs"]
mod common;
mod datasets;
mod devices;
mod documents;
mod edit;
mod eval_segments;
mod examples;
mod formats;
mod inspect;
mod known_scenes;
mod labels;
mod leftovers;
mod limits;
mod lpips_convert;
mod masks;
mod measures;
mod moved;
mod numbers;
mod orientations;
mod outputs;
mod pack;
mod prepare;
mod resume;
mod segment;
mod segment_history;
mod series;
mod slurm;
mod static_scene;
mod sweep;
mod sweep_files;
mod track;
mod train;
mod units;
