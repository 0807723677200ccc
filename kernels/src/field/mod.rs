//! Factorised 4D feature field: planes, lines and times sampled at points (paper: equations 3 and 4, the T4 product).
//! Parameter layout lives in [`shape`], the fast kernels in [`cpu`], the oracle in [`mod@reference`].
//!
//! Feature r of a level at point (x, y, z) and time t, bilinear in planes and linear in lines and times:
//!
//! ```text
//! f_r = (Mxy_r(x, y) vz_r(z) + Mxz_r(x, z) vy_r(y) + Myz_r(y, z) vx_r(x)) vt_r(t)        r = 1 .. R
//! ```
//!
//! The paper's equation 4 has sums over r instead, `T4 = (sum_r Mxy_r o vz_r + ..) o (sum_r vt_r)` with R_s and R_t
//! terms. The product by channels is what the released code computes, and is used here for these reasons:
//!
//! - With the sums, a level is one number at each point and time. Two levels would give the decoder two inputs, whereas
//!   the paper speaks of sampled *features* that are concatenated (in its figure of the network), and the released
//!   decoder has 64.
//! - With the sums, the time factor of a level is one curve shared by all places. By channels, each spatial pattern has
//!   its own curve, so that places can move at different times: the decoder's first layer weights R products of space
//!   and time, whereas equation 4 is a single one.
//! - The number of parameters is the same either way, so the paper's sizes do not distinguish the two.
//!
//! Equation 4 is therefore best read as TensoRF's notation for a tensor of rank R, whose components are then used as
//! features. The sum is not offered as an option: it would need its own initial values (sums of R products of the
//! present ones start near 300), and is expected to do far worse, as Gaussians with the same two numbers would deform
//! alike; this was not measured.

mod backward;
pub mod cpu;
#[cfg(feature = "cube")]
mod cube;
mod ops;
pub mod params;
pub mod reference;
mod sample;
pub mod shape;

#[cfg(test)]
mod tests;

pub use cpu::{backward, forward};
pub use ops::{FieldBackwardOps, FieldOps, FieldTensors, field};
pub use params::{FieldGrads, FieldParams};
pub use shape::{FieldShape, FieldShapeError, LevelShape, TensorSpan};
