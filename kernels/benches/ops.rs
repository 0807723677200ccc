//! Splatting, forward and forward with backward, on three translucent scenes, with one and two threads.
//!
//! `cargo bench -p volseggs-kernels --bench ops -- [S] [M] [L] [--repeats N]`. Prints a Markdown table and
//! writes nothing. The gradient of the image (L2 against noise) is made beforehand and not timed.
#![allow(missing_docs, clippy::unwrap_used)]

mod common;

use burn::tensor::{Device, Tensor, TensorData};
use common::Splatter;

/// Name, Gaussians, pixels a side, seed.
const SCENES: [(&str, usize, usize, u64); 3] =
    [("S", 10_000, 200, 11), ("M", 50_000, 400, 12), ("L", 150_000, 800, 13)];

fn main() {
    let (names, repeats) = common::arguments(9);
    println!(
        "kernels: {}; milliseconds, {repeats} runs after one that is not counted\n",
        volseggs_kernels::simd_level()
    );
    println!("| scene | pass | threads | wall min | wall median | CPU min | CPU median |");
    println!("|---|---|--:|--:|--:|--:|--:|");
    let mut notes = Vec::new();
    for (name, n, size, seed) in SCENES {
        if !names.is_empty() && !names.iter().any(|wanted| wanted == name) {
            continue;
        }
        let device = Device::flex();
        let splatter = Splatter::new(&common::scene(n, seed), common::camera(size), &device);
        let image = common::image(&splatter.forward());
        let gradient = TensorData::new(common::l2_gradient(&image, seed), [size, size, 4]);
        let gradient = Tensor::<3>::from_data(gradient, &device);
        for threads in [1, 2] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let forward = common::measure(repeats, || splatter.forward());
                let both = common::measure(repeats, || splatter.backward(&splatter.forward(), &gradient));
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
