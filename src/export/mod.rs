//! Writers (and readers) of files for other programs.

pub mod animation;
pub mod images;
pub mod ply;
pub mod scene;
