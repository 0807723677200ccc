//! ViSNeRF: a radiance field in factorised grids, of which rays are marched.
//!
//! Yao, Lu and Wang, "ViSNeRF: Efficient multidimensional neural radiance field representation for visualization synthesis of
//! dynamic volumetric scenes", IEEE PacificVis 2025, on the grids of TensoRF (Chen et al., ECCV 2022). Density and appearance
//! each have planes, lines and vectors of time ([`grid`]); two networks make density and colour of their features
//! ([`network`]); `kernels::march` samples rays and adds up what they see.
//!
//! As published, but for this:
//!
//! - The box is that of the visual hull of the images with a margin, where the published code is given it.
//! - The rate falls from the first step to the last. There Adam was made anew five times, at the rate of the start, although
//!   the grids keep their size; `visnerf.restarts = [6000, 9000, 12000, 16500, 21000]` does so here.
//! - Places that are empty may be passed over (`visnerf.occupancy`): cells are marked for each training time by the opacity
//!   at their centres, with their neighbours. The published code has such a mask for the last of its parameters alone, and its
//!   option to turn it on never does.
//! - A ray that misses the box is replaced by another one; there such rays are taken out before training.
//! - The last sample of a ray counts as the others, where there it has no length.
//! - Biases of the linear map behind the grids: none, as there. Total variation of a single vector is left out; there it is 0
//!   divided by 0.

mod batch;
pub mod grid;
pub mod loss;
mod method;
mod model;
pub mod network;
pub mod occupancy;
pub mod rays;
mod training;

#[cfg(test)]
mod tests;

pub use method::VisNerfMethod;
pub use model::{VisNerf, VisNerfSpec};
pub use training::VisNerfTraining;
