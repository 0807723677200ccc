//! Measures splatting, forward and forward plus backward, on three translucent scenes, with one and two threads.
//!
//! `cargo bench -p volseggs-kernels --bench ops -- [S] [M] [L] [--repeats N] [--device flex|wgpu|cuda]`. Prints a
//! Markdown table and writes nothing. The gradient of the image (L2 against noise) is computed beforehand and not timed.
//! On a GPU, each run ends when the device has finished.
#![allow(missing_docs, clippy::unwrap_used)]

mod common;

use burn::tensor::{Device, Tensor, TensorData};
use common::Splatter;

/// Name, number of Gaussians, pixels per side, seed.
const SCENES: [(&str, usize, usize, u64); 3] =
    [("S", 10_000, 200, 11), ("M", 50_000, 400, 12), ("L", 150_000, 800, 13)];

/// Waits until the device has finished all queued work, then returns `value`.
fn finished<T>(device: &Device, value: T) -> T {
    device.sync().unwrap();
    value
}

/// Opens a compiled-in device: `flex`, the adapter that wgpu prefers, or the first CUDA device.
fn open(name: &str) -> Device {
    match name {
        "flex" => Device::flex(),
        #[cfg(feature = "wgpu")]
        "wgpu" => Device::wgpu_options().init().unwrap(),
        #[cfg(feature = "cuda")]
        "cuda" => Device::cuda(0),
        other => panic!("no device \"{other}\" in this build"),
    }
}

#[cfg(any(feature = "wgpu", feature = "cuda"))]
fn adapter(device: &Device) -> String {
    volseggs_kernels::gpu_paths(device).map_or_else(|| "GPU".to_owned(), |paths| paths.adapter)
}

#[cfg(not(any(feature = "wgpu", feature = "cuda")))]
fn adapter(_: &Device) -> String {
    "GPU".to_owned()
}

fn main() {
    let (names, repeats, device_name) = common::arguments(9);
    let device = open(&device_name);
    let on_cpu = device_name == "flex";
    let threads = if on_cpu { vec![1, 2] } else { vec![1] };
    let kernels = if on_cpu { volseggs_kernels::simd_level() } else { format!("{device_name}, {}", adapter(&device)) };
    println!("kernels: {kernels}; milliseconds, {repeats} runs after one that is not counted\n");
    println!("| scene | pass | threads | wall min | wall median | CPU min | CPU median |");
    println!("|---|---|--:|--:|--:|--:|--:|");
    let mut notes = Vec::new();
    for (name, n, size, seed) in SCENES {
        if !names.is_empty() && !names.iter().any(|wanted| wanted == name) {
            continue;
        }
        let splatter = Splatter::new(&common::scene(n, seed), common::camera(size), &device);
        let image = common::image(&splatter.forward());
        let gradient = TensorData::new(common::l2_gradient(&image, seed), [size, size, 4]);
        let gradient = Tensor::<3>::from_data(gradient, &device);
        for &threads in &threads {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let forward = common::measure(repeats, || finished(&device, splatter.forward()));
                let both =
                    common::measure(repeats, || finished(&device, splatter.backward(&splatter.forward(), &gradient)));
                for (pass, (wall, cpu)) in [("forward", forward), ("forward + backward", both)] {
                    let times = [wall.min(), wall.median(), cpu.min(), cpu.median()].map(|ms| format!("{ms:.1}"));
                    println!("| {name} | {pass} | {threads} | {} |", times.join(" | "));
                }
            });
        }
        let alpha: Vec<f32> = image.chunks_exact(4).map(|p| p[3]).collect();
        let share =
            |f: &dyn Fn(f32) -> bool| 100.0 * alpha.iter().filter(|&&a| f(a)).count() as f64 / alpha.len() as f64;
        notes.push(format!(
            "{name}: {n} Gaussians, {size}x{size}; alpha > 0.999 in {:.1} % of the pixels, 0 in {:.1} %",
            share(&|a| a > 0.999),
            share(&|a| a == 0.0)
        ));
    }
    println!();
    notes.iter().for_each(|note| println!("{note}"));
}
