//! Writers (and readers) of files for other programs.

pub mod animation;
pub mod exporters;
pub mod exr;
pub mod fields;
pub mod images;
pub mod labels;
pub mod npy;
pub mod ply;
pub mod splat_file;
pub mod spz;
pub mod video;
