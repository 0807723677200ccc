//! Differentiable operations for deformable Gaussian scenes, as burn backend extensions.
//!
//! One folder per op, each with the same files: `mod.rs` (the public function on tensors and the backend trait),
//! `reference.rs` (plain f64 loops, the oracle of the tests), `ops.rs` or `autodiff.rs` (gradient registration), `cpu`
//! (the fast kernels over slices, shared by every CPU backend) and `cube` (the GPU kernels, with the feature `wgpu` or
//! `cuda`). `contributors` is in `splat`, whose compositing rule it shares. `changes`, `shading` and `sine` are ops on
//! the CPU and tensor operations on GPUs. `bell_rows` has functions over slices and is no op.
//!
//! This crate does not deal with files, configurations or the command line.
#![allow(deprecated)] // burn deprecates the NdArray backend in favour of Flex; both are supported here.

mod backend;
mod camera;
#[cfg(feature = "cube")]
mod cube;
mod log_exp;
mod scale;
mod tensors;
mod turn;

pub mod activation;
pub mod adam;
pub mod bell_rows;
pub mod changes;
pub mod contrast;
pub mod decoder;
pub mod field;
pub mod march;
pub mod path_opacity;
pub mod photometric;
pub mod sh;
pub mod shading;
pub mod sine;
pub mod splat;
pub mod ssim;
pub mod tv;

pub use camera::Camera;
#[cfg(feature = "cube")]
pub use cube::{GpuPaths, gpu_paths, is_gpu};
pub use scale::ScaleOps;

/// Returns the vector instructions that the kernels use: the widest of the machine, unless `VOLSEGGS_SIMD` asks for none
/// (`scalar`) or for AVX2 (`avx2`), with which tests reach the other paths and benchmarks compare against them.
fn arch() -> pulp::Arch {
    static ARCH: std::sync::LazyLock<pulp::Arch> =
        std::sync::LazyLock::new(|| match std::env::var("VOLSEGGS_SIMD").as_deref() {
            Ok("scalar") => pulp::Arch::Scalar,
            #[cfg(target_arch = "x86_64")]
            Ok("avx2") => pulp::x86::V3::try_new().map_or(pulp::Arch::Scalar, pulp::Arch::V3),
            _ => pulp::Arch::new(),
        });
    *ARCH
}

/// Returns the name of the vector instructions that the CPU kernels use on this machine.
pub fn simd_level() -> String {
    let arch = format!("{:?}", arch());
    let name = arch.split('(').next().unwrap_or_default();
    match name {
        "V3" => "AVX2 and FMA".into(),
        "V4" => "AVX-512".into(),
        "Scalar" => "no vector instructions".into(),
        other => other.into(),
    }
}
