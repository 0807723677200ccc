//! Writers (and readers) of files for other programs.

pub mod animation;
pub mod ply;
