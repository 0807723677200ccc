//! Measures one training step: each stage alone, and the whole step.
//!
//! `cargo bench --bench train_step -- [GAUSSIANS]... [--repeats N]`, by default 10000, 50000 and 150000
//! Gaussians in a unit ball, images of 800x800, the model of the `best` preset, the `flex` device. Prints
//! Markdown tables. The whole step reads a dataset of two views from a temporary folder, removed at the end.
//!
//! `cargo bench --bench train_step -- --scene SCENE.safetensors --data DATASET` uses a trained scene and its training
//! images instead. The scene must have SH degree 3. With `--device wgpu` or `--device cuda`, the whole step and the frames
//! are measured on that GPU, and the single stages are skipped.
#![allow(missing_docs, clippy::unwrap_used)]

#[path = "../kernels/benches/common/mod.rs"]
mod common;
#[path = "support/counting.rs"]
mod counting;
#[path = "support/whole.rs"]
mod whole;

use burn::tensor::{Device, Tensor, TensorData};
use common::{Numbers, SH_COEFFICIENTS, Samples, Scene, Splatter, measure};
use volseggs::config::types::{Config, DecoderKind, ModelConfig};
use volseggs::device::DeviceName;
use volseggs::method::preset;
use volseggs::model::HostGaussians;
use volseggs::model::encoder::factorised::field_shape;
use volseggs::train::densify::{self, Statistics};
use volseggs::train::due::DueChanges;
use volseggs::train::losses;
use volseggs_kernels::adam::{AdamStep, LrPattern, adam_step};
use volseggs_kernels::changes::{COLUMNS, WIDTHS};
use volseggs_kernels::decoder::{self, DecoderGrads, DecoderParams, DecoderShape};
use volseggs_kernels::field::{self, FieldGrads, FieldParams, FieldShape};
use volseggs_kernels::tv::{DifferenceReduction, TvGrads, TvKind, TvWeights, tv};

#[global_allocator]
static ALLOCATOR: counting::Counting = counting::Counting;

/// Image width and height in pixels.
const SIZE: usize = 800;
/// A time between two knots.
const TIME: f32 = 0.37;
/// Distance of the cameras from the origin.
const DISTANCE: f64 = 4.0;

type Stage = (&'static str, Samples);

fn main() {
    volseggs::memory::keep_freed_pages(); // as the program does
    let (words, repeats, device_name) = common::arguments(7);
    let repeats = repeats.max(5);
    let after = |flag: &str| words.iter().position(|w| w == flag).and_then(|i| words.get(i + 1));
    let trained = after("--scene").zip(after("--data"));
    let device = device_name.parse::<DeviceName>().and_then(DeviceName::open).unwrap();
    let on_gpu = volseggs::device::runs_ahead(&device);
    let mut sizes: Vec<usize> = words.iter().filter_map(|w| w.parse().ok()).collect();
    if sizes.is_empty() {
        sizes = vec![10_000, 50_000, 150_000];
    }
    println!(
        "{SIZE}x{SIZE}, {device_name}, {} threads, {}; milliseconds, min / median of {repeats} runs",
        rayon::current_num_threads(),
        volseggs_kernels::simd_level()
    );
    if let Some((scene, data)) = trained {
        let (host, points) = whole::trained_scene(scene.as_ref());
        let sizes = [host.opacity_logits.len()];
        if !on_gpu {
            table("stage, alone", &sizes, &[stages(host, Some(&points), repeats)]);
        }
        let step = whole::trained_step(scene.as_ref(), data.as_ref(), repeats, &device);
        table("part of `Trainer::step`", &sizes, &[step]);
        table("frame", &sizes, &[whole::frames(scene.as_ref(), 3 * repeats, &device)]);
        return;
    }
    if !on_gpu {
        let columns: Vec<Vec<Stage>> = sizes.iter().map(|&n| stages(common::scene(n, 7), None, repeats)).collect();
        table("stage, alone", &sizes, &columns);
    }
    let columns: Vec<Vec<Stage>> = sizes.iter().map(|&n| whole::whole_step(n, repeats, &device)).collect();
    table("part of `Trainer::step`", &sizes, &columns);
}

fn table(title: &str, sizes: &[usize], columns: &[Vec<Stage>]) {
    let heads: Vec<String> = sizes.iter().map(|n| format!("{}k", *n as f64 / 1e3)).collect();
    println!("\n| {title} | {} |\n|---|{}", heads.join(" | "), "--:|".repeat(sizes.len()));
    for (row, (name, _)) in columns[0].iter().enumerate() {
        let cells: Vec<String> =
            columns.iter().map(|c| format!("{:.1} / {:.1}", c[row].1.min(), c[row].1.median())).collect();
        println!("| {name} | {} |", cells.join(" | "));
    }
}

/// Measures every stage of a joint step on the Gaussians of `scene`, each alone. The field is read at `points` in
/// [-1, 1] `[N, 3]`, or at the means if `None`.
fn stages(scene: Scene, points: Option<&[f32]>, repeats: usize) -> Vec<Stage> {
    let config = preset("best").unwrap();
    let n = scene.opacity_logits.len();
    let mut out: Vec<Stage> = Vec::new();
    let (image, seen) = splat_stages(&scene, repeats, &mut out);
    let points = points.unwrap_or(&scene.means);
    let lengths = field_and_decoder(points, &seen, &config.model, repeats, &mut out);
    loss_stages(&image, &config, repeats, &mut out);
    let names = ["Adam, Gaussians", "Adam, field and decoder"];
    let attributes = [(3 * n, false), (4 * n, false), (3 * n, false), (n, false), (48 * n, true)];
    let field = lengths.map(|len| (len, false));
    for (name, group) in names.into_iter().zip([&attributes[..], &field[..]]) {
        out.push((name, adam_stage(group, repeats)));
    }
    out.push(("densification (+2 %, once in 100 steps)", densify_stage(scene, &config, repeats)));
    out
}

/// Measures the op without the autodiff tape. Returns the image, and which Gaussians have a gradient.
fn splat_stages(scene: &Scene, repeats: usize, out: &mut Vec<Stage>) -> (Vec<f32>, Vec<bool>) {
    let device = Device::flex();
    let splatter = Splatter::new(scene, common::camera(SIZE), &device);
    out.push(("splat forward", measure(repeats, || splatter.forward()).0));
    let forward = splatter.forward();
    let image = common::image(&forward);
    let gradient = TensorData::new(common::l2_gradient(&image, 8), [SIZE, SIZE, 4]);
    let gradient = Tensor::<3>::from_data(gradient, &device);
    out.push(("splat backward", measure(repeats, || splatter.backward(&forward, &gradient)).0));
    let slopes = common::host(splatter.backward(&forward, &gradient).opacity_logits);
    (image, slopes.into_iter().map(|g| g != 0.0).collect())
}

/// Measures the slice functions beneath the two ops; as in the ops, their backward pass skips rows that are not `seen`.
/// Returns the lengths of the parameter buffers.
fn field_and_decoder(
    places: &[f32],
    seen: &[bool],
    config: &ModelConfig,
    repeats: usize,
    out: &mut Vec<Stage>,
) -> [usize; 9] {
    let n = seen.len();
    let shape: FieldShape = field_shape(config);
    let mut r = Numbers(9);
    let lengths = [shape.planes_len(), shape.lines_len(), shape.times_len()];
    let [planes, lines, times] = lengths.map(|len| r.take(len, |r| 0.1 + 0.4 * r.uniform()));
    let params = FieldParams { planes: &planes, lines: &lines, times: &times };
    let mut features = vec![0.0; n * shape.features_len()];
    let forward = || field::forward(&shape, params, places, TIME, &mut features);
    out.push(("field forward", measure(repeats, forward).0));
    let grad_features = r.take(features.len(), Numbers::normal);
    let [mut g_planes, mut g_lines, mut g_times] = lengths.map(|len| vec![0.0; len]);
    let mut g_points = vec![0.0; 3 * n];
    let backward = || {
        let (planes, lines, times, points) = (&mut g_planes[..], &mut g_lines[..], &mut g_times[..], &mut g_points[..]);
        let grads = FieldGrads { planes, lines, times, points };
        field::backward(&shape, params, places, TIME, &grad_features, Some(seen), grads);
    };
    out.push(("field backward", measure(repeats, backward).0));

    let head_sizes = match config.decoder {
        DecoderKind::Heads => WIDTHS.to_vec(),
        DecoderKind::Shared => vec![COLUMNS],
    };
    let (inputs, width, heads) = (shape.features_len(), config.width, head_sizes.len());
    let decoder_shape = DecoderShape { inputs, width, head_sizes };
    let sizes = [inputs * width, width, width * heads * width, heads * width, width * COLUMNS, COLUMNS];
    let [w0, b0, w1, b1, w2, b2] = sizes.map(|len| r.take(len, |r| 0.2 * r.normal()));
    let params = DecoderParams { w0: &w0, b0: &b0, w1: &w1, b1: &b1, w2: &w2, b2: &b2 };
    let mut change = vec![0.0; n * COLUMNS];
    let forward = || decoder::forward(&decoder_shape, params, &features[..], &mut change);
    out.push(("decoder forward", measure(repeats, forward).0));
    let grad_change = r.take(change.len(), Numbers::normal);
    let mut g = sizes.map(|len| vec![0.0; len]);
    let mut g_x = vec![0.0; features.len()];
    let backward = || {
        let [w0, b0, w1, b1, w2, b2] = g.each_mut().map(|v| &mut v[..]);
        let grads = DecoderGrads { w0, b0, w1, b1, w2, b2, features: &mut g_x, own: &mut [] };
        decoder::backward(&decoder_shape, params, &features[..], &grad_change, Some(seen), grads);
    };
    out.push(("decoder backward", measure(repeats, backward).0));

    let [w0, b0, w1, b1, w2, b2] = sizes;
    let [planes, lines, times] = lengths;
    [planes, lines, times, w0, b0, w1, b1, w2, b2]
}

/// Measures the losses as the trainer composes them, forward and backward on the autodiff tape; TV through its slice
/// function.
fn loss_stages(image: &[f32], config: &Config, repeats: usize, out: &mut Vec<Stage>) {
    let device = Device::flex().autodiff();
    let mut r = Numbers(10);
    let noisy = image.iter().map(|v| v + 0.05 * r.normal() as f32).collect();
    let tensor = |v: Vec<f32>| Tensor::<3>::from_data(TensorData::new(v, [SIZE, SIZE, 4]), &device);
    let (target, image) = (tensor(noisy), tensor(image.to_vec()).require_grad());
    let loss = || losses::photometric(image.clone(), target.clone(), &config.loss).loss.backward();
    out.push(("photometric loss, both passes", measure(repeats, loss).0));
    let loss = || losses::dssim(image.clone(), target.clone()).backward();
    out.push(("DSSIM, both passes", measure(repeats, loss).0));

    let shape = field_shape(&config.model);
    let lengths = [shape.planes_len(), shape.lines_len(), shape.times_len()];
    let [planes, lines, times] = lengths.map(|len| r.take(len, |r| 0.1 + 0.4 * r.uniform()));
    let params = FieldParams { planes: &planes, lines: &lines, times: &times };
    let (space, time) = (config.loss.tv as f32, config.loss.tv_time as f32);
    let weights =
        TvWeights { space, time, one_prior_space: 0.0, one_prior_time: 0.0, reduction: DifferenceReduction::Mean };
    let [mut planes, mut lines, mut times] = lengths.map(|len| vec![0.0; len]);
    let penalty = || {
        let grads = TvGrads { planes: &mut planes, lines: &mut lines, times: &mut times };
        tv(params, &shape, TvKind::First, weights, grads)
    };
    out.push(("total variation, both passes", measure(repeats, penalty).0));
}

/// Measures one Adam step over buffers of the given lengths; the flag marks rows of spherical harmonics.
fn adam_stage(buffers: &[(usize, bool)], repeats: usize) -> Samples {
    let mut r = Numbers(11);
    let mut state: Vec<_> = buffers
        .iter()
        .map(|&(len, sh)| {
            let gradient = r.take(len, Numbers::normal);
            (vec![0.5f32; len], gradient, vec![0.1f32; len], vec![0.1f32; len], sh)
        })
        .collect();
    let step = AdamStep {
        lr: 1e-3,
        beta1: 0.9,
        beta2: 0.999,
        eps: 1e-15,
        bias_correction1: 0.5,
        bias_correction2: 0.5,
        lr_pattern: None,
    };
    let rows = LrPattern { row_len: 48, head_len: 3, tail_factor: 0.05 };
    let all = || {
        for (param, gradient, m, v, sh) in &mut state {
            adam_step(param, gradient, m, v, AdamStep { lr_pattern: sh.then_some(rows), ..step }).unwrap();
        }
    };
    measure(repeats, all).0
}

/// Measures densification: the plan, the attributes and both moments.
fn densify_stage(scene: Scene, config: &Config, repeats: usize) -> Samples {
    let n = scene.opacity_logits.len();
    let mut r = Numbers(12);
    let statistics =
        Statistics { gradient: r.take(n, Numbers::uniform), views: vec![1.0; n], opacity: r.take(n, Numbers::uniform) };
    let due = DueChanges { grow_to: Some(n + n / 50), prune: true, ..DueChanges::default() };
    let host = HostGaussians {
        means: scene.means,
        rotations: scene.rotations,
        log_scales: scene.log_scales,
        opacity_logits: scene.opacity_logits,
        sh: scene.sh,
        sh_stride: SH_COEFFICIENTS,
        ..HostGaussians::default()
    };
    let change = || {
        let rows = densify::plan(0, due, &statistics, &host.opacity_logits, &host.log_scales, config, DISTANCE);
        let new = densify::apply(&rows, &host, 1, 2);
        let moments: Vec<_> =
            host.columns().map(|c| [0, 1].map(|_| densify::gather_moments(c.values, &rows, c.width))).collect();
        (new, moments)
    };
    measure(repeats, change).0
}
