//! Differentiable operations for deformable Gaussian scenes, as burn backend extensions.
//!
//! One folder an op, each with the same rooms: `mod.rs` (the public function on tensors and the
//! backend trait), `reference.rs` (plain f64 loops, the oracle of the tests), `autodiff.rs`
//! (gradient registration) and `cpu` (the fast kernels over slices, shared by every CPU backend).
//!
//! This crate knows nothing of files, configurations or the command line.
#![allow(deprecated)] // burn deprecates the NdArray backend in favour of Flex; both are supported here.

mod backend;
mod camera;

pub mod adam;
pub mod decoder;
pub mod field;
pub mod splat;
pub mod ssim;
pub mod tv;

pub use camera::Camera;

/// The vector instructions that the CPU kernels use on this machine.
pub fn simd_level() -> String {
    let arch = format!("{:?}", pulp::Arch::new());
    let name = arch.split('(').next().unwrap_or_default();
    match name {
        "V3" => "AVX2 and FMA".into(),
        "V4" => "AVX-512".into(),
        other => other.into(),
    }
}
