//! Opacities by path length and their gradients, on every device, against the plain f64 version.

#![allow(missing_docs, clippy::unwrap_used)]

mod common;

use burn::tensor::{Device, Tensor, TensorData};
use common::{Tested, camera, noise, settings, to_vec};
use volseggs_kernels::path_opacity::path_opacity;
use volseggs_kernels::path_opacity::reference::{SeenGaussian, logit};
use volseggs_kernels::splat::contributors::contributors;
use volseggs_kernels::splat::{Rendering, SplatInputs, splat};

const EYE: [f32; 3] = [0.3, -3.5, 1.2];

/// Means, rotations, log scales, logits.
type Inputs = [Vec<f32>; 4];

/// Gaussians of all shapes, from nearly transparent to nearly opaque.
fn inputs(n: usize) -> Inputs {
    let log_scales = noise(3, 3 * n).into_iter().map(|v| 2.5 * v - 3.0).collect();
    let logits = (0..n).map(|i| 30.0 * (i as f32 + 0.5) / n as f32 - 15.0).collect();
    [noise(1, 3 * n), noise(2, 4 * n), log_scales, logits]
}

/// Returns the result, and the gradients of its sum weighted by `weights`; the device must be one with gradients.
fn run(inputs: &Inputs, exponent: f32, weights: &[f32], device: &Device) -> (Vec<f32>, Inputs) {
    let rows = |v: &[f32], width: usize| {
        Tensor::<2>::from_data(TensorData::new(v.to_vec(), [v.len() / width, width]), device).require_grad()
    };
    let (means, rotations, log_scales) = (rows(&inputs[0], 3), rows(&inputs[1], 4), rows(&inputs[2], 3));
    let flat = |v: &[f32]| Tensor::<1>::from_data(TensorData::new(v.to_vec(), [v.len()]), device);
    let logits = flat(&inputs[3]).require_grad();
    let out = path_opacity(means.clone(), rotations.clone(), log_scales.clone(), logits.clone(), EYE, exponent);
    let g = (out.clone() * flat(weights)).sum().backward();
    let gradients = [
        to_vec(means.grad(&g).unwrap()),
        to_vec(rotations.grad(&g).unwrap()),
        to_vec(log_scales.grad(&g).unwrap()),
        to_vec(logits.grad(&g).unwrap()),
    ];
    (to_vec(out.inner()), gradients)
}

fn reference(inputs: &[Vec<f64>; 4], exponent: f32) -> Vec<f64> {
    let [means, rotations, log_scales, logits] = inputs;
    let seen = |i: usize| SeenGaussian {
        mean: std::array::from_fn(|c| means[3 * i + c]),
        rotation: std::array::from_fn(|c| rotations[4 * i + c]),
        log_scales: std::array::from_fn(|c| log_scales[3 * i + c]),
        logit: logits[i],
        eye: EYE.map(f64::from),
        exponent: f64::from(exponent),
    };
    (0..logits.len()).map(|i| logit(&seen(i))).collect()
}

fn opacities_and_every_gradient_match_the_reference(on: Tested) {
    let device = on.device.autodiff();
    let n = 40;
    let mut inputs = inputs(n);
    inputs[1][8..12].fill(0.0); // no rotation
    inputs[2][9..12].copy_from_slice(&[-2.0, -2.0, -40.0]); // flatter than what counts
    let weights = noise(5, n);
    for exponent in [0.25, 0.5, 1.0] {
        let (out, gradients) = run(&inputs, exponent, &weights, &device);
        let mut exact = inputs.each_ref().map(|v| v.iter().map(|&v| f64::from(v)).collect::<Vec<_>>());
        for (i, (a, b)) in out.iter().zip(reference(&exact, exponent)).enumerate() {
            assert!((f64::from(*a) - b).abs() < 2e-5 * b.abs().max(1.0), "{exponent}, {i}: {a} against {b}");
        }
        for (which, found) in gradients.iter().enumerate() {
            let width = found.len() / n;
            for i in 0..found.len() {
                let row = i / width;
                if which == 1 && row == 2 {
                    assert_eq!(found[i], 0.0, "no rotation has no gradient");
                    continue;
                }
                let at = exact[which][i];
                let mut value = |x: f64| {
                    exact[which][i] = x;
                    reference(&exact, exponent)[row] * f64::from(weights[row])
                };
                let (up, down) = (value(at + 1e-5), value(at - 1e-5));
                value(at);
                let slope = (up - down) / 2e-5;
                let scale = found[row * width..][..width].iter().fold(1e-2f32, |m, g| m.max(g.abs()));
                let off = (slope - f64::from(found[i])).abs();
                assert!(off < 2e-4 * f64::from(scale), "{exponent}, input {which}, {i}: {slope} against {}", found[i]);
            }
        }
    }
}

fn round_gaussians_and_exponent_0_keep_their_opacity(on: Tested) {
    let device = on.device.autodiff();
    let mut inputs = inputs(20);
    let (out, _) = run(&inputs, 0.0, &[1.0; 20], &device);
    for (a, b) in out.iter().zip(&inputs[3]) {
        assert!((a - b).abs() < 2e-5 * b.abs().max(1.0), "{a} against {b}");
    }
    inputs[2].fill(-2.0);
    let (out, _) = run(&inputs, 1.0, &[1.0; 20], &device);
    for (a, b) in out.iter().zip(&inputs[3]) {
        assert!((a - b).abs() < 2e-5 * b.abs().max(1.0), "{a} against {b}");
    }
}

fn a_flat_gaussian_is_denser_from_its_edge(on: Tested) {
    let device = on.device.autodiff();
    // two discs before the eye, one facing it (thin along y), one edge on (thin along z)
    let mean = [EYE[0], EYE[1] + 4.0, EYE[2]];
    let log_scales = vec![-1.0, -4.0, -1.0, -1.0, -1.0, -4.0];
    let inputs = [mean.repeat(2), [1.0, 0.0, 0.0, 0.0].repeat(2), log_scales, vec![-1.0; 2]];
    let (out, _) = run(&inputs, 1.0, &[1.0; 2], &device);
    assert!(out[0] < -2.9 && out[1] > 0.0, "{out:?}");
}

fn poison_stays_where_it_is(on: Tested) {
    let device = on.device.autodiff();
    let n = 8;
    let clean = inputs(n);
    let mut bad = clean.clone();
    bad[0][0] = f32::NAN;
    bad[1][5] = f32::INFINITY;
    bad[2][6] = f32::NAN;
    bad[3][3] = f32::NAN;
    bad[3][4] = f32::NEG_INFINITY;
    bad[0][15..18].copy_from_slice(&EYE); // the eye itself
    let (out, gradients) = run(&bad, 0.5, &vec![1.0; n], &device);
    let (out_clean, gradients_clean) = run(&clean, 0.5, &vec![1.0; n], &device);
    assert!(gradients.iter().flatten().all(|g| g.is_finite()), "{gradients:?}");
    for row in 0..5 {
        assert!(!out[row].is_finite(), "{row}: {}", out[row]);
        for g in &gradients {
            let width = g.len() / n;
            assert!(g[row * width..][..width].iter().all(|g| *g == 0.0), "{row}: {g:?}");
        }
    }
    assert_eq!(out[6..], out_clean[6..]);
    for (bad, clean) in gradients.iter().zip(&gradients_clean) {
        let width = bad.len() / n;
        assert_eq!(bad[6 * width..], clean[6 * width..]);
    }
}

fn what_is_drawn_and_what_contributes_have_the_seen_opacities(on: Tested) {
    let device = &on.device;
    let n = 30;
    let [means, rotations, log_scales, _] = inputs(n);
    let camera = camera(32, 24);
    let rows = |v: Vec<f32>, width: usize| Tensor::<2>::from_data(TensorData::new(v, [n, width]), device);
    let sh = Tensor::<3>::from_data(TensorData::new(noise(7, 3 * n), [n, 1, 3]), device);
    let (rotations, log_scales) = (rows(rotations, 4), rows(log_scales, 3));
    let base = SplatInputs::new(rows(means, 3), rotations, log_scales, Tensor::zeros([n], device), sh);
    let plain = settings(camera, 0);
    let by_path = Rendering { path_opacity: 0.7, ..plain.rendering }.seen_by(camera);
    let drawn = to_vec(splat(base.clone(), by_path).image);
    let SplatInputs { means, rotations, log_scales, opacity_logits, .. } = base.clone();
    let seen = path_opacity(means, rotations, log_scales, opacity_logits, camera.position(), 0.7);
    let replaced = SplatInputs { opacity_logits: seen, ..base.clone() };
    assert_eq!(drawn, to_vec(splat(replaced.clone(), plain).image));
    assert_ne!(drawn, to_vec(splat(base.clone(), plain).image));
    let pixels: Vec<u32> = (0..32 * 24).collect();
    let listed = contributors(&base, &by_path, &pixels).unwrap();
    assert_eq!(listed, contributors(&replaced, &plain, &pixels).unwrap());
}

fn bits_do_not_depend_on_the_number_of_threads(on: Tested) {
    let device = on.device.autodiff();
    let n = 40_000;
    let inputs = inputs(n);
    let weights = noise(5, n);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (out, gradients) = pool.install(|| run(&inputs, 0.5, &weights, &device));
        out.into_iter().chain(gradients.into_iter().flatten()).map(f32::to_bits).collect::<Vec<_>>()
    };
    let one = on(1);
    assert!(one == on(2) && one == on(5));
}

volseggs_testing::on_every_device!(
    crate::common::open => opacities_and_every_gradient_match_the_reference,
    round_gaussians_and_exponent_0_keep_their_opacity,
    a_flat_gaussian_is_denser_from_its_edge,
    poison_stays_where_it_is,
    what_is_drawn_and_what_contributes_have_the_seen_opacities,
);
volseggs_testing::on_every_cpu_device!(
    crate::common::open => bits_do_not_depend_on_the_number_of_threads,
);
