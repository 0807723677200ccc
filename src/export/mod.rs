//! Writers (and readers) of files for other programs.

pub mod animation;
pub mod images;
pub mod labels;
pub mod ply;
pub mod splat_file;
pub mod spz;
pub mod video;
