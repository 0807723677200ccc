//! Measures the time to open a scene, and the share of it that the digest check takes.
//!
//! `cargo bench --bench load -- [GAUSSIANS]... [--repeats N]`, by default 30000 and 150000 Gaussians with the model of
//! the `best` preset. The file is in the system's page cache; read from disk, loading takes longer and the share is
//! smaller. Prints a Markdown table of medians. Loads with and without a digest alternate, so that both see the same
//! machine conditions.
#![allow(missing_docs, clippy::unwrap_used)]

use burn::tensor::Device;
use safetensors::SafeTensors;
use std::time::Instant;
use volseggs::method::preset;
use volseggs::model::HostGaussians;
use volseggs::model::Scene;
use volseggs::model::scene::SceneSpec;
use volseggs::model::size::coefficients;
use volseggs::tensors::DIGEST;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() {
    volseggs::memory::keep_freed_pages(); // as the program does
    let words: Vec<String> = std::env::args().skip(1).collect();
    let repeats = words.iter().position(|w| w == "--repeats").and_then(|i| words.get(i + 1)?.parse().ok());
    let repeats: usize = repeats.unwrap_or(101);
    let mut sizes: Vec<usize> = words
        .iter()
        .enumerate()
        .filter(|(i, _)| *i == 0 || words[i - 1] != "--repeats")
        .filter_map(|(_, w)| w.parse().ok())
        .collect();
    if sizes.is_empty() {
        sizes = vec![30_000, 150_000];
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.safetensors");
    let device = Device::flex();
    println!("| Gaussians | MB | without a digest, ms | with its check, ms | the check, % of loading |");
    println!("|--:|--:|--:|--:|--:|");
    for n in sizes {
        scene(n, &device).save(&path).unwrap();
        let megabytes = std::fs::metadata(&path).unwrap().len() as f64 / 1e6;
        let bare = folder.path().join("bare.safetensors");
        std::fs::write(&bare, without_digest(&std::fs::read(&path).unwrap())).unwrap();
        let (mut plain, mut checked) = (Vec::new(), Vec::new());
        for _ in 0..repeats {
            plain.push(milliseconds(|| drop(Scene::load(&bare, &device).unwrap())));
            checked.push(milliseconds(|| drop(Scene::load(&path, &device).unwrap())));
        }
        let [plain, checked] = [plain, checked].map(median);
        println!("| {n} | {megabytes:.1} | {plain:.2} | {checked:.2} | {:.1} |", 100.0 * (checked - plain) / checked);
    }
}

/// Returns the same file without its digest, as another program would write it.
fn without_digest(bytes: &[u8]) -> Vec<u8> {
    let (_, header) = SafeTensors::read_metadata(bytes).unwrap();
    let mut tensors = SafeTensors::deserialize(bytes).unwrap().tensors();
    tensors.retain(|(name, _)| name != DIGEST);
    safetensors::serialize(tensors, header.metadata().clone()).unwrap()
}

fn milliseconds(work: impl FnOnce()) -> f64 {
    let started = Instant::now();
    work();
    1e3 * started.elapsed().as_secs_f64()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Returns a scene of `n` Gaussians with the model of the `best` preset.
fn scene(n: usize, device: &Device) -> Scene {
    let config = preset("best").unwrap();
    let k = coefficients(&config.model) as usize;
    let values = |len: usize| (0..len).map(|i| (i as f32 * 0.618).fract() - 0.5).collect::<Vec<f32>>();
    let gaussians = HostGaussians {
        means: values(3 * n),
        rotations: values(4 * n),
        log_scales: values(3 * n),
        opacity_logits: values(n),
        sh: values(3 * k * n),
        sh_stride: k,
        ..HostGaussians::default()
    };
    let spec = SceneSpec {
        sh_degree: config.model.sh_degree,
        model: config.model,
        centre: [0.0; 3],
        half_size: [1.0; 3],
        background: [1.0; 3],
        deformed: true,
        d3dgs: None,
        packed_from: None,
    };
    Scene::new(gaussians, spec, 0, device)
}
