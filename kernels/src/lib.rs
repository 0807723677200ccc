//! Differentiable operations for deformable Gaussian scenes, as burn backend extensions.
//!
//! One folder per op, each with the same files: `mod.rs` (the public function on tensors and the backend trait),
//! `reference.rs` (plain f64 loops, the oracle of the tests), `ops.rs` or `autodiff.rs` (gradient registration), `cpu`
//! (the fast kernels over slices, shared by every CPU backend) and `cube` (the GPU kernels, with the feature `wgpu` or
//! `cuda`). `contributors` is in `splat`, whose compositing rule it shares. `changes`, `shading` and `sine` are ops on
//! the CPU and tensor operations on GPUs. `bell_rows` has functions over slices and is no op.
//!
//! | op | does | gradients |
//! |---|---|---|
//! | `splat` | Gaussians (rotations and scales, or covariances) and a camera -> colour and alpha `[H, W, 4]`, radii; on a GPU also their statistics for densification | all attributes, and `screen_offsets` |
//! | `contributors` | Gaussians, a camera, pixels -> contributing Gaussians and their weights (lists on the host) | none |
//! | `field` | points, a time, planes/lines/time vectors -> features | points and all parameters |
//! | `decoder` | features, and numbers of each Gaussian's own -> changes of mean, rotation, log-scale, opacity; trunk and heads fused | all inputs and weights |
//! | `changes` | changes `[N, 11]` -> by attribute; one gradient for the whole instead of one for each slice | changes |
//! | `march` | optical depths and colours of ray samples, ray by ray -> colour and alpha `[R, 4]`; `sample` places them | depths and colours |
//! | `path_opacity` | opacity logits as a camera sees them, by the ray's path through each Gaussian | all |
//! | `photometric` | L1 or L2 of colour and alpha, and the mean square, in one pass; on a GPU also the target image from its bytes | first image, computed in the forward sweep |
//! | `contrast` | contrastive loss of unit pixel features by mask; plain slices on the host, not a backend op | features, with the loss |
//! | `sine` | rows and biases -> `sin(omega (x + b))`; tensor operations on GPUs | both |
//! | `ssim` | mean SSIM, 11-tap Gaussian window | first image, computed in the forward sweep |
//! | `tv` | smoothness of the field's parameters | all parameters, computed in the forward sweep |
//! | `adam` | one step in place, rates by row pattern | none |
//!
//! `shading` is an op on the CPU and tensor operations on GPUs. `splat` calls it for the colours of shaded Gaussians
//! (`model.appearance = "headlight"`), and `path_opacity` for the opacities that the camera sees (`model.path_opacity`), as do
//! the lists of contributors, so that everything that draws, trains or cuts them out is consistent. Which bands
//! the colour coefficients are of follows from their number (`sh::Bands`), so that nothing else can contradict it.
//!
//! Where the backward pass is an op too, its `...BackwardOps` trait is implemented by backends that compute, not by the one
//! that records gradients: there is no second derivative.
//!
//! On a GPU the host reads almost nothing back: in training, the number of tile entries in one step of 16 and the loss in
//! one of 20; densification statistics stay on the device until they are due. Only the field's gradients use float atomics
//! (or compare and exchange); no kernel needs plane operations or 64-bit numbers.
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

pub use camera::PinholeCamera;
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
