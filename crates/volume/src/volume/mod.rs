//! Volumes: files and series, transfer functions, the ray caster, synthetic scenes. Produces images; knows nothing of
//! datasets beyond the camera, and nothing of models.

pub mod components;
pub mod directions;
pub mod error;
pub mod formats;
pub mod grid;
pub mod picture;
pub mod placement;
pub mod raycast;
pub mod series;
pub mod source;
pub mod synthetic;
pub mod transfer;
