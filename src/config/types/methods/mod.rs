//! Sections of methods other than ours, each with all settings of its method.

mod d3dgs;

pub use d3dgs::D3dgsConfig;
