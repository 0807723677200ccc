//! `volseggs doctor`

use super::{CliError, print_json};
use crate::device::DeviceName;
use clap::Args;
use serde::Serialize;

/// Show devices, features and limits: what would run where.
#[derive(Debug, Args)]
pub struct DoctorArgs {
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report {
    version: &'static str,
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
}

impl DoctorArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let devices = DeviceName::all()
            .into_iter()
            .map(|d| DeviceReport { name: d.to_string(), description: d.describe(), works: d.open().is_ok() })
            .collect();
        let report = Report {
            version: env!("CARGO_PKG_VERSION"),
            devices,
            simd: volseggs_kernels::simd_level(),
            threads: rayon::current_num_threads(),
            memory_total_bytes: memory("MemTotal:"),
            memory_available_bytes: memory("MemAvailable:"),
        };
        if self.json {
            return print_json(&report);
        }
        println!("volseggs {}", report.version);
        for (i, d) in report.devices.iter().enumerate() {
            let default = if i == 0 { " (default)" } else { "" };
            println!("device {}{default}: {}", d.name, d.description);
        }
        println!("kernels: {}, {} threads (RAYON_NUM_THREADS sets them)", report.simd, report.threads);
        if let (Some(total), Some(free)) = (report.memory_total_bytes, report.memory_available_bytes) {
            println!("memory: {:.1} GB, {:.1} GB available", total as f64 / 1e9, free as f64 / 1e9);
        }
        println!("not in this build: wgpu, cuda, tch");
        Ok(())
    }
}

fn memory(key: &str) -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix(key))?;
    line.split_whitespace().next()?.parse::<u64>().ok().map(|kib| kib * 1024)
}
