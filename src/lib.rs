//! Deformable 3D Gaussians from rendered images of time-varying volumes.
//!
//! The pipeline is the layout: `data` (images and cameras) -> `model` and `train` -> `eval` and
//! `export`. Data flows one way; no folder reaches back. The binary's commands live in `cli`.

// `no field is ever read` of derived modules is burn's business
pub mod config;
pub mod files;
pub mod model;
pub mod rng;
