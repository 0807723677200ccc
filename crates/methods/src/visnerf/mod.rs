//! ViSNeRF: a radiance field in factorised grids, rendered by ray marching.
//!
//! Yao, Lu and Wang, "ViSNeRF: Efficient multidimensional neural radiance field representation for visualization
//! synthesis of dynamic volumetric scenes", IEEE PacificVis 2025, on the grids of TensoRF (Chen et al., ECCV 2022).
//! Density and appearance each have planes, lines and time vectors ([`grid`]); two networks compute density and colour
//! from their features ([`network`]); `kernels::march` samples rays and accumulates their colours.
//!
//! As published, except that:
//!
//! - The box is that of the images' visual hull with a margin; the published code takes it as an input.
//! - The learning rate decays from the first step to the last. The published code recreates Adam five times, at the
//!   initial rate, although the grids keep their size; `visnerf.restarts = [6000, 9000, 12000, 16500, 21000]` does the
//!   same here.
//! - Empty space can be skipped (`visnerf.occupancy`): cells are marked for each training time by the opacity at their
//!   centres, together with their neighbours. The published code has such a mask only for the last of its parameters,
//!   and its option to enable it has no effect.
//! - A ray that misses the box is replaced by another one; the published code removes such rays before training.
//! - The last sample of a ray counts like the others; in the published code it has no length.
//! - The linear map after the grids has no biases, as in the published code. The total variation of a single vector is
//!   omitted; in the published code it is 0 divided by 0.

mod batch;
pub mod grid;
pub mod loss;
mod method;
mod model;
pub mod network;
pub mod occupancy;
pub mod rays;
mod settings;
mod training;

#[cfg(test)]
mod tests;

pub use method::VisNerfMethod;
pub use model::{VisNerf, VisNerfSpec};
pub use settings::VisNerfConfig;
pub use training::VisNerfTraining;
