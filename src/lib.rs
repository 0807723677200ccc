//! Deformable 3D Gaussians from rendered images of time-varying volumes: train, segment, track and edit them.
//!
//! The program `volseggs` is made of this library. A volume becomes a trained scene in a few calls:
//!
//! ```no_run
//! use std::{path::Path, sync::atomic::AtomicBool};
//! use volseggs::prelude::*;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let (data, scene) = (Path::new("jets"), Synthetic::Jets);
//! let volume = PrepareSource::Synthetic { scene, dims: [96; 3], steps: 30 };
//! prepare(&volume, &scene.transfer_function()?, &PrepareOptions::default(), data, &|_| (), &AtomicBool::new(false))?;
//! let dataset = Dataset::open(data, &OpenOptions::default())?;
//! let mut trainer = Trainer::new(preset("quick")?, &dataset, &DeviceName::all()[0].open()?)?;
//! while trainer.steps_done() < trainer.total_steps() {
//!     trainer.step(&dataset.train)?;
//! }
//! // [H, W, 4]: colour and alpha
//! let image: Vec<f32> = trainer.scene().render(dataset.train.frames[0].camera.to_kernel(), 0.5);
//! trainer.scene().save(Path::new("scene.safetensors"))?;
//! # Ok(())
//! # }
//! ```
//!
//! | to | see |
//! |---|---|
//! | read volumes, render datasets of them | [`volume`], [`prepare`](mod@prepare), [`data`] |
//! | configure and train, also with other methods | [`config`], [`train`], [`method`] |
//! | open a trained run and work on it | [`run::OpenRun`] |
//! | find segments, follow and edit them | [`segment`], [`track`], [`edit`] |
//! | measure and export | [`metrics`], [`eval`], [`export`] |
//! | add a loss, encoder, schedule, metric, file format, dataset layout, source of masks or method of one's own | [`extend`] |
//!
//! | feature | default | adds |
//! |---|---|---|
//! | `flex`, `ndarray` | yes | the two CPU devices |
//! | `wgpu` | yes | GPUs through Vulkan, Metal or DX12 |
//! | `view` | yes | the viewer in a browser |
//! | `cuda` | no | NVIDIA GPUs through CUDA |
//! | `tch` | no | LibTorch on the CPU |
//!
//! `examples/` has whole programs: `train_and_render`, `segment_by_click`, `export`, `custom_loss`; `extended` registers one of
//! each kind of extension.
//!
//! The crates underneath, from the lowest: `volseggs-base`, `volseggs-volume` (neither names burn), `volseggs-kernels`,
//! `volseggs-core`, `volseggs-methods` and `volseggs-segment`. Their modules are re-exported here.

#![deny(clippy::print_stdout, clippy::print_stderr)] // they panic on a closed pipe; see `terminal`

#[macro_use]
extern crate volseggs_base;

pub mod cli;
pub mod compare;
pub mod demo;
pub mod eval;
pub mod extend;
pub mod lpips_weights;
pub mod run;
pub mod sweep;
#[cfg(feature = "view")]
pub mod view;

use volseggs_base::{csv, nesting, numbers, registry, terminal};
pub use volseggs_base::{
    draw, durations, files, log, memory, name, points, process, program, report, rng, shell, tensors, user_error,
    versioned, words,
};
pub use volseggs_core::{config, device, export, metrics, model, train};
pub use volseggs_methods as method;
pub use volseggs_segment::{edit, segment, track};
pub use volseggs_volume::{data, prepare, volume};

/// What most programs need.
pub mod prelude {
    pub use crate::config::types::Config;
    pub use crate::data::{Camera, Dataset, OpenOptions, Split, SplitName};
    pub use crate::device::DeviceName;
    pub use crate::edit::EditStack;
    pub use crate::method::preset;
    pub use crate::metrics::psnr::psnr;
    pub use crate::metrics::ssim::ssim_rgb;
    pub use crate::model::{HostGaussians, Model, Scene, ToKernel};
    pub use crate::prepare::{PrepareOptions, PrepareSource, SegmentOptions, prepare};
    pub use crate::run::OpenRun;
    pub use crate::segment::segmentation::Segmentation;
    pub use crate::train::Trainer;
    pub use crate::volume::synthetic::Synthetic;
    pub use crate::volume::transfer::TransferFunction;
}

/// The tensor library used in this crate's signatures, re-exported in its exact version.
pub use burn;

/// Runs the program: parses the command line, runs the command and prints any error. The binary does nothing else; a
/// custom program calls this after registering its extensions, see [`extend`].
#[must_use]
pub fn main() -> std::process::ExitCode {
    memory::keep_freed_pages();
    method::add_sections();
    process::report_file_limits();
    let command = cli::Cli::read();
    let started = process::start_threads().map_err(cli::CliError::failure);
    let outcome = started.and_then(|()| command.run());
    let printed = terminal::finish().map_err(|e| cli::CliError::failure(format!("standard output: {e}")));
    match outcome.and(printed) {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(error) => {
            errln!("error: {error}");
            std::process::ExitCode::from(error.code())
        }
    }
}
