//! `volseggs doctor`

use super::{CliError, print_json};
use crate::device::DeviceName;
use crate::memory;
use crate::program::{self, Build};
use clap::Args;
use serde::Serialize;

/// Show the devices, features and limits of this build and machine.
#[derive(Debug, Args)]
pub struct DoctorArgs {
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct DoctorReport {
    version: &'static str,
    /// Null if the executable cannot be read.
    build: Option<&'static Build>,
    devices: Vec<DeviceReport>,
    simd: String,
    threads: usize,
    memory_total_bytes: Option<u64>,
    memory_available_bytes: Option<u64>,
}

#[derive(Serialize)]
struct DeviceReport {
    name: String,
    description: &'static str,
    works: bool,
    /// Why it does not work.
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    gpu: Option<Gpu>,
}

/// The capabilities of a GPU, and the code paths that the kernels use on it.
#[derive(Serialize)]
struct Gpu {
    adapter: String,
    runtime: String,
    max_buffer_bytes: u64,
    shared_memory_bytes: usize,
    max_units: u32,
    plane: [u32; 2],
    atomics: &'static str,
    because: String,
}

#[cfg(any(feature = "wgpu", feature = "cuda"))]
fn gpu(device: &burn::tensor::Device) -> Option<Gpu> {
    let p = volseggs_kernels::gpu_paths(device)?;
    Some(Gpu {
        adapter: p.adapter,
        runtime: p.runtime,
        max_buffer_bytes: p.max_binding,
        shared_memory_bytes: p.shared_memory,
        max_units: p.max_units,
        plane: p.plane,
        atomics: if p.native_float_atomics { "native" } else { "compare and exchange" },
        because: p.reason,
    })
}

#[cfg(not(any(feature = "wgpu", feature = "cuda")))]
fn gpu(_: &burn::tensor::Device) -> Option<Gpu> {
    None
}

fn device(name: DeviceName) -> DeviceReport {
    let opened = name.open();
    DeviceReport {
        name: name.to_string(),
        description: name.describe(),
        works: opened.is_ok(),
        problem: opened.as_ref().err().map(ToString::to_string),
        gpu: opened.ok().as_ref().and_then(gpu),
    }
}

impl DoctorArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let devices = DeviceName::all().into_iter().map(device).collect();
        let build = program::build();
        let report = DoctorReport {
            version: env!("CARGO_PKG_VERSION"),
            build: build.as_ref().ok().copied(),
            devices,
            simd: volseggs_kernels::simd_level(),
            threads: rayon::current_num_threads(),
            memory_total_bytes: memory::system("MemTotal:"),
            memory_available_bytes: memory::system("MemAvailable:"),
        };
        if self.json {
            return print_json(&report);
        }
        outln!("volseggs {}", report.version);
        match build {
            Ok(Build { digest, file, bytes, milliseconds }) => {
                let mb = *bytes as f64 / 1e6;
                outln!("build {digest}: XXH3-128 of {} ({mb:.1} MB, read in {milliseconds:.0} ms)", file.display());
            }
            Err(error) => outln!("build unknown: {error}"),
        }
        for (i, d) in report.devices.iter().enumerate() {
            let default = if i == 0 { " (default)" } else { "" };
            outln!("device {}{default}: {}", d.name, d.description);
            if let Some(problem) = &d.problem {
                outln!("  unavailable on this machine: {problem}");
            }
            if let Some(g) = &d.gpu {
                outln!("  {} ({})", g.adapter, g.runtime);
                let (gb, kib) = (g.max_buffer_bytes as f64 / 1e9, g.shared_memory_bytes / 1024);
                outln!(
                    "  buffers up to {gb:.1} GB, {kib} KiB shared memory, {} units, planes of {} to {} (not required)",
                    g.max_units,
                    g.plane[0],
                    g.plane[1]
                );
                outln!(
                    "  gradients of the field: {} float atomics ({}); every other sum without atomics",
                    g.atomics,
                    g.because
                );
            }
        }
        outln!("kernels: {}, {} threads (change with RAYON_NUM_THREADS)", report.simd, report.threads);
        if let (Some(total), Some(free)) = (report.memory_total_bytes, report.memory_available_bytes) {
            outln!("memory: {:.1} GB, {:.1} GB available", total as f64 / 1e9, free as f64 / 1e9);
        }
        let missing: Vec<String> =
            DeviceName::every().iter().filter(|d| !DeviceName::all().contains(d)).map(ToString::to_string).collect();
        if !missing.is_empty() {
            outln!("not in this build: {} (cargo features)", missing.join(", "));
        }
        Ok(())
    }
}
