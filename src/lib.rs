//! Deformable 3D Gaussians from rendered images of time-varying volumes.
//!
//! The pipeline is the layout: `volume` (files, transfer functions, ray caster) -> `prepare` (a dataset) ->
//! `data` (images and cameras) -> `model` and `train` -> `eval` and
//! `export`. Data flows one way; no folder reaches back. The binary's commands live in `cli`.

pub mod cli;
pub mod config;
pub mod data;
pub mod demo;
pub mod device;
pub mod draw;
pub mod edit;
pub mod eval;
pub mod export;
pub mod files;
pub mod log;
pub mod memory;
pub mod metrics;
pub mod model;
pub mod points;
pub mod prepare;
pub mod rng;
pub mod segment;
pub mod track;
pub mod train;
pub mod volume;
