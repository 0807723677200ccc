//! Choice of the kernels' code path on a device, made by trial: what drivers report and what they do differ in both
//! directions.

use super::Words;
use super::atomic::{AddF32, Native};
use crate::cube::prelude::*;
use burn::backend::DispatchDevice;
use burn::tensor::Device;
use burn_cubecl::cubecl::ir::features::AtomicUsage;
use burn_cubecl::cubecl::ir::{ElemType, FloatKind, Type};
use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{LazyLock, Mutex};

/// How the kernels run on one GPU.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GpuPaths {
    /// Name of the adapter.
    pub adapter: String,
    /// Name of the runtime, with its shading language.
    pub runtime: String,
    /// Whether the device's own float atomics are used for the field's gradients, rather than compare-and-exchange.
    pub native_float_atomics: bool,
    /// Reason for this choice.
    pub reason: String,
    /// Largest buffer that can be bound, in bytes.
    pub max_binding: u64,
    /// Shared memory per cube, in bytes.
    pub shared_memory: usize,
    /// Maximum number of units per cube.
    pub max_units: u32,
    /// Width of a plane (warp, subgroup), smallest and largest; not used by the kernels.
    pub plane: [u32; 2],
}

/// Whether the device is a GPU, with or without gradients.
pub fn is_gpu(device: &Device) -> bool {
    matches!(device.clone().inner().as_dispatch(), DispatchDevice::Cube(_))
}

/// Returns the code paths on a device; `None` if it is not a GPU.
pub fn gpu_paths(device: &Device) -> Option<GpuPaths> {
    let device = device.clone().inner();
    let DispatchDevice::Cube(cube) = device.as_dispatch() else { return None };
    let client = cube.client();
    let hardware = &client.properties().hardware;
    let (native_float_atomics, reason) = atomics(&client);
    Some(GpuPaths {
        adapter: device.identity().map_or_else(|| "unknown".into(), |identity| identity.name.to_string()),
        runtime: client.name().to_owned(),
        native_float_atomics,
        reason,
        max_binding: client.properties().memory.max_page_size,
        shared_memory: hardware.max_shared_memory_size,
        max_units: hardware.max_units_per_cube,
        plane: [hardware.plane_size_min, hardware.plane_size_max],
    })
}

/// Whether to use the device's own float atomics.
pub(crate) fn native_atomics(client: &Client) -> bool {
    atomics(client).0
}

static KNOWN: LazyLock<Mutex<HashMap<String, (bool, String)>>> = LazyLock::new(Mutex::default);

/// Decides whether to use native float atomics, by one trial per runtime, and gives the reason;
/// `VOLSEGGS_GPU_ATOMICS=native` or `exchange` overrides the trial.
fn atomics(client: &Client) -> (bool, String) {
    match std::env::var("VOLSEGGS_GPU_ATOMICS").as_deref() {
        Ok("native") => return (true, "VOLSEGGS_GPU_ATOMICS=native".into()),
        Ok("exchange") => return (false, "VOLSEGGS_GPU_ATOMICS=exchange".into()),
        _ => {}
    }
    let mut known = KNOWN.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    known.entry(client.name().to_owned()).or_insert_with(|| try_native(client)).clone()
}

fn try_native(client: &Client) -> (bool, String) {
    let float = Type::atomic(ElemType::Float(FloatKind::F32));
    if !client.properties().atomic_type_usage(float).contains(AtomicUsage::Add) {
        return (false, "the driver reports no float atomics".into());
    }
    let sum = catch_unwind(AssertUnwindSafe(|| {
        let out = Words::f32s(client, &[0.0]);
        halves::launch::<Native>(client, CubeCount::Static(2, 1, 1), CubeDim::new_1d(64), out.arg());
        f32::from_bits(out.read(client)[0])
    }));
    match sum {
        Ok(64.0) => (true, "the driver reports float atomics, and a trial gave the correct sum".into()),
        Ok(other) => (false, format!("the driver reports float atomics, but a trial gave {other} instead of 64")),
        Err(_) => (false, "the driver reports float atomics, but a trial failed".into()),
    }
}

#[cube(launch)]
fn halves<A: AddF32>(out: &mut [Atomic<A::Storage>]) {
    A::add(&out[0], 0.5f32);
}
