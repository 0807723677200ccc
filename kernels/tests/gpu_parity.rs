//! Ops on the GPU against the same ops on the CPU, which other tests compare with the f64 references: random and poison
//! scenes, forward and gradients. A device that does not start skips its tests; see `common::open`.
#![cfg(any(feature = "wgpu", feature = "cuda"))]
#![allow(missing_docs, clippy::unwrap_used)]

mod common;

use burn::tensor::{Device, Tensor, TensorData};
use common::{
    COEFFICIENTS, Numbers, Tested, by_covariances, camera, cpu, highest_degree, random_scene, random_scene_of,
    relative_error, settings, to_vec,
};
use volseggs_kernels::adam::{AdamStep, AdamTensors, LrPattern, adam};
use volseggs_kernels::decoder::{DecoderShape, DecoderWeights, decoder};
use volseggs_kernels::field::{FieldShape, LevelShape};
use volseggs_kernels::photometric::{Distance, photometric_loss};
use volseggs_kernels::splat::reference::ReferenceScene;
use volseggs_kernels::ssim::mean_ssim;
use volseggs_kernels::tv::{DifferenceReduction, TvKind, TvWeights, total_variation};

fn values(n: usize, seed: u64) -> Vec<f32> {
    let mut r = Numbers(seed);
    (0..n).map(|_| r.next() as f32).collect()
}

fn tensor<const D: usize>(v: &[f32], shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(v.to_vec(), shape), device)
}

fn off(a: &[f32], b: &[f32]) -> f64 {
    relative_error(a, &b.iter().map(|&v| f64::from(v)).collect::<Vec<_>>())
}

/// Runs `f` on the CPU and on the GPU and checks that each result is off by less than `limit` of its norm.
fn alike(on: &Tested, limit: f64, f: impl Fn(&Device) -> Vec<Vec<f32>>) {
    let expected = f(&cpu().autodiff());
    let ours = f(&on.device.clone().autodiff());
    assert_eq!(ours.len(), expected.len());
    for (k, (a, b)) in ours.iter().zip(&expected).enumerate() {
        let error = off(a, b);
        println!("result {k}: {error:.1e}");
        assert!(
            error < limit,
            "result {k} is off by {error:.1e}: {:?} for {:?}",
            &a[..a.len().min(8)],
            &b[..b.len().min(8)]
        );
    }
}

fn splats_alike(on: &Tested, scene: &ReferenceScene, width: usize, height: usize, degree: usize) {
    let s = settings(camera(width, height), degree);
    let weights: Vec<f32> = values(width * height * 4, 31).iter().map(|v| v - 0.5).collect();
    let (image, gradients) = common::gradients(scene, s, &weights, &cpu());
    let (ours, our_gradients) = common::gradients(scene, s, &weights, &on.device);
    let worst = ours.iter().zip(&image).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    let many = ours.iter().zip(&image).filter(|(a, b)| (*a - *b).abs() > 1e-4).count();
    // a pixel may fall on the other side of the 1/255 or the 1e-4 cutoff
    assert!(worst < 0.02 && many * 200 <= ours.len(), "{width}x{height}: worst {worst:.1e}, {many} of {}", ours.len());
    for (((name, _), a), b) in common::fields(scene).iter().zip(&our_gradients).zip(&gradients) {
        let error = off(a, b);
        println!("{width}x{height} degree {degree}: {name} {error:.1e}");
        assert!(error < 2e-3, "{width}x{height} degree {degree}: {name} off by {error:.1e}");
    }
}

fn random_scenes_of_every_degree_and_odd_sizes(on: Tested) {
    for (k, (w, h)) in [(1, 1), (1, 40), (17, 3), (33, 65), (100, 47), (41, 30)].into_iter().enumerate() {
        let (scene, degree) = (random_scene_of(300, COEFFICIENTS[k], 7 + k as u64), highest_degree(COEFFICIENTS[k]));
        splats_alike(&on, &scene, w, h, degree);
        splats_alike(&on, &by_covariances(scene), w, h, degree);
    }
}

fn deep_tiles_of_many_batches_and_segments(on: Tested) {
    let mut scene = random_scene(3000, 1, 5);
    scene.opacity_logits.iter_mut().for_each(|o| *o -= 3.0);
    scene.log_scales.iter_mut().for_each(|s| *s += 1.0);
    splats_alike(&on, &scene, 48, 40, 1);
}

fn opaque_walls_end_pixels_early(on: Tested) {
    let mut scene = random_scene(2000, 0, 6);
    scene.opacity_logits.iter_mut().for_each(|o| *o += 5.0);
    scene.log_scales.iter_mut().for_each(|s| *s += 1.5);
    splats_alike(&on, &scene, 40, 40, 0);
}

fn no_gaussians_and_none_in_front_of_the_camera(on: Tested) {
    let mut behind = random_scene(20, 0, 2);
    behind.means.chunks_exact_mut(3).for_each(|m| m[2] -= 20.0);
    for scene in [random_scene(0, 0, 1), behind] {
        let s = settings(camera(20, 10), 0);
        let image = to_vec(volseggs_kernels::splat::splat(common::inputs(&scene, &on.device), s).image);
        assert!(image.chunks_exact(4).all(|p| p == [0.1, 0.2, 0.3, 0.0]));
    }
}

fn poison_is_culled_and_never_spreads(on: Tested) {
    let s = settings(camera(40, 30), 1);
    let weights = values(40 * 30 * 4, 4);
    let clean = random_scene(40, 1, 23);
    let kinds = [clean.clone(), by_covariances(clean.clone())];
    let cases = kinds.iter().flat_map(|clean| common::fields(clean).iter().map(move |(f, field)| (clean, f, field)));
    for (clean, f, field) in cases.filter(|(_, name, _)| **name != "screen_offsets") {
        // one Gaussian for each kind of poison
        let mut scene = clean.clone();
        let width = field(&mut scene).len() / 40;
        let bad = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, 1e30, -1e30, 1e-30, 88.0, -110.0, 1e8];
        for (i, value) in bad.into_iter().enumerate() {
            field(&mut scene)[i * width + i % width] = value;
        }
        let (image, gradients) = common::gradients(&scene, s, &weights, &on.device);
        let (expected, _) = common::gradients(&scene, s, &weights, &cpu());
        assert!(image.iter().all(|v| v.is_finite()), "{f}: image");
        for (k, g) in gradients.iter().enumerate() {
            assert!(g.iter().all(|v| v.is_finite()), "{f}: gradient {k}");
        }
        let worst = image.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 0.02, "{f}: {worst}");
    }
    let mut scene = clean.clone();
    let mut identity = clean;
    scene.rotations[..4].fill(0.0);
    identity.rotations[..4].copy_from_slice(&[1.0, 0.0, 0.0, 0.0]);
    let (a, b) =
        (common::gradients(&scene, s, &weights, &on.device), common::gradients(&identity, s, &weights, &on.device));
    assert_eq!(a.0, b.0);
}

fn the_same_device_gives_the_same_bits_again(on: Tested) {
    let s = settings(camera(60, 50), 2);
    let weights = values(60 * 50 * 4, 8);
    let scene = random_scene(800, 2, 9);
    for scene in [scene.clone(), by_covariances(scene)] {
        let first = common::gradients(&scene, s, &weights, &on.device);
        assert_eq!(first, common::gradients(&scene, s, &weights, &on.device));
    }
}

fn shape(channels: usize) -> FieldShape {
    let levels = vec![LevelShape { resolution: [5, 6, 7] }, LevelShape { resolution: [9, 1, 8] }];
    FieldShape { levels, time_knots: 4, channels }
}

fn field(on: Tested) {
    for (channels, time) in [(8, 0.37), (20, 0.0), (16, 1.0)] {
        let shape = shape(channels);
        let n = 300;
        let mut points: Vec<f32> = values(3 * n, 5).iter().map(|v| 2.6 * v - 1.3).collect();
        points[30] = f32::NAN;
        points[34] = f32::INFINITY;
        alike(&on, 1e-5, |device| {
            let p = tensor(&values(shape.planes_len(), 1), [shape.planes_len()], device).require_grad();
            let l = tensor(&values(shape.lines_len(), 2), [shape.lines_len()], device).require_grad();
            let t = tensor(&values(shape.times_len(), 3), [shape.times_len()], device).require_grad();
            let x = tensor(&points, [n, 3], device).require_grad();
            let out = volseggs_kernels::field::field(p.clone(), l.clone(), t.clone(), x.clone(), &shape, time);
            let g = (out.clone() * tensor(&values(n * shape.features_len(), 4), out.dims(), device)).sum().backward();
            vec![
                to_vec(out.inner()),
                to_vec(p.grad(&g).unwrap()),
                to_vec(l.grad(&g).unwrap()),
                to_vec(t.grad(&g).unwrap()),
                to_vec(x.grad(&g).unwrap()),
            ]
        });
    }
}

fn decoder_of_separate_and_shared_heads(on: Tested) {
    let cases = [(vec![3, 4, 3, 1], 64, 48, 0, 1300), (vec![11], 24, 10, 0, 70), (vec![3, 4, 3, 1], 64, 48, 16, 1300)];
    for (head_sizes, width, inputs, beside, n) in cases {
        let shape = DecoderShape { inputs, width, head_sizes };
        let all = shape.b1_len();
        let columns = shape.outputs();
        let signed = |n: usize, seed: u64| values(n, seed).iter().map(|v| 0.5 * (v - 0.5)).collect::<Vec<f32>>();
        alike(&on, 2e-5, |device| {
            let features = inputs - beside;
            let x = tensor(&signed(n * features, 1), [n, features], device).require_grad();
            let own = (beside > 0).then(|| tensor(&signed(n * beside, 9), [n, beside], device).require_grad());
            let w0 = tensor(&signed(inputs * width, 2), [inputs, width], device).require_grad();
            let b0 = tensor(&signed(width, 3), [width], device).require_grad();
            let w1 = tensor(&signed(width * all, 4), [width, all], device).require_grad();
            let b1 = tensor(&signed(all, 5), [all], device).require_grad();
            let w2 = tensor(&signed(width * columns, 6), [width, columns], device).require_grad();
            let b2 = tensor(&signed(columns, 7), [columns], device).require_grad();
            let weights = DecoderWeights {
                trunk: (w0.clone(), b0.clone()),
                hidden: (w1.clone(), b1.clone()),
                output: (w2.clone(), b2.clone()),
            };
            let out = decoder(x.clone(), own.clone(), weights, &shape);
            let g = (out.clone() * tensor(&signed(n * columns, 8), [n, columns], device)).sum().backward();
            vec![
                to_vec(out.inner()),
                to_vec(x.grad(&g).unwrap()),
                to_vec(w0.grad(&g).unwrap()),
                to_vec(b0.grad(&g).unwrap()),
                to_vec(w1.grad(&g).unwrap()),
                to_vec(b1.grad(&g).unwrap()),
                to_vec(w2.grad(&g).unwrap()),
                to_vec(b2.grad(&g).unwrap()),
                own.map_or_else(Vec::new, |own| to_vec(own.grad(&g).unwrap())),
            ]
        });
    }
}

fn photometric(on: Tested) {
    let (h, w) = (67, 81);
    for kind in [Distance::Absolute, Distance::Squared] {
        alike(&on, 1e-5, |device| {
            let x = tensor(&values(4 * h * w, 16), [h, w, 4], device).require_grad();
            let out = photometric_loss(x.clone(), tensor(&values(4 * h * w, 17), [h, w, 4], device), kind, 0.2);
            let g = out.loss.clone().mul_scalar(2.0).backward();
            vec![to_vec(out.loss.inner()), to_vec(out.squared.inner()), to_vec(x.grad(&g).unwrap())]
        });
    }
}

fn ssim_of_three_and_four_channels(on: Tested) {
    for (h, w, channels) in [(19, 23, 3), (40, 33, 4), (3, 5, 3)] {
        alike(&on, 1e-3, |device| {
            let n = h * w * channels;
            let x = tensor(&values(n, 6), [h, w, channels], device).require_grad();
            let s = mean_ssim(x.clone(), tensor(&values(n, 7), [h, w, channels], device));
            let g = s.clone().backward();
            vec![to_vec(s.inner()), to_vec(x.grad(&g).unwrap())]
        });
    }
}

fn total_variation_of_both_kinds_by_mean_and_by_sum(on: Tested) {
    let shape = shape(8);
    let (mean, sum) = (DifferenceReduction::Mean, DifferenceReduction::Sum);
    for (kind, reduction) in
        [(TvKind::First, mean), (TvKind::First, sum), (TvKind::Second, mean), (TvKind::Second, sum)]
    {
        let weights = TvWeights { space: 1.0, time: 0.5, one_prior_space: 0.1, one_prior_time: 0.2, reduction };
        alike(&on, 1e-5, |device| {
            let p = tensor(&values(shape.planes_len(), 1), [shape.planes_len()], device).require_grad();
            let l = tensor(&values(shape.lines_len(), 2), [shape.lines_len()], device).require_grad();
            let t = tensor(&values(shape.times_len(), 3), [shape.times_len()], device).require_grad();
            let v = total_variation(p.clone(), l.clone(), t.clone(), &shape, kind, weights);
            let g = v.backward();
            let grads = [p.grad(&g), l.grad(&g), t.grad(&g)].map(|t| to_vec(t.unwrap()));
            let mut out = vec![to_vec(v.inner())];
            out.extend(grads);
            out
        });
    }
}

fn adam_in_place_and_on_shared_memory(on: Tested) {
    let n = 48 * 50;
    let step = AdamStep {
        lr: 0.01,
        beta1: 0.9,
        beta2: 0.999,
        eps: 1e-15,
        bias_correction1: 0.19,
        bias_correction2: 0.002,
        lr_pattern: Some(LrPattern { row_len: 48, head_len: 3, tail_factor: 0.05 }),
    };
    alike(&on, 1e-6, |device| {
        let device = device.clone().inner();
        let param = tensor(&values(n, 1), [n], &device);
        let kept = param.clone();
        let tensors = AdamTensors {
            param,
            moment_1: tensor(&values(n, 2), [n], &device),
            moment_2: tensor(&values(n, 3), [n], &device),
        };
        let (out, bad) = adam(tensors, tensor(&values(n, 4), [n], &device), step);
        assert_eq!(bad, None);
        assert_eq!(to_vec(kept), values(n, 1), "another holder keeps its values");
        let (out, _) = adam(out, tensor(&values(n, 5), [n], &device), step);
        vec![to_vec(out.param), to_vec(out.moment_1), to_vec(out.moment_2)]
    });
}

fn contributors(on: Tested) {
    let scene = random_scene(500, 1, 41);
    let s = settings(camera(50, 40), 1);
    let pixels: Vec<u32> = (0..2000).step_by(7).chain([3, 3, 1999]).collect();
    let lists = |device: &Device| {
        volseggs_kernels::splat::contributors::contributors(&common::inputs(&scene, device), &s, &pixels).unwrap()
    };
    let (ours, expected) = (lists(&on.device), lists(&cpu()));
    let mut other = 0;
    for p in 0..pixels.len() {
        let ((a, wa), (b, wb)) = (ours.row(p), expected.row(p));
        if a != b {
            other += 1; // a Gaussian on the other side of a cutoff
            continue;
        }
        assert!(wa.iter().zip(wb).all(|(a, b)| (a - b).abs() < 1e-4), "pixel {p}: {wa:?} for {wb:?}");
    }
    assert!(other * 50 <= pixels.len(), "{other} of {} pixels have different lists", pixels.len());
    let none =
        volseggs_kernels::splat::contributors::contributors(&common::inputs(&scene, &on.device), &s, &[]).unwrap();
    assert!(none.is_empty() && none.indices.is_empty());
    assert!(
        volseggs_kernels::splat::contributors::contributors(&common::inputs(&scene, &on.device), &s, &[2000]).is_err()
    );
}

volseggs_testing::on_every_gpu!(
    crate::common::open =>
    random_scenes_of_every_degree_and_odd_sizes,
    deep_tiles_of_many_batches_and_segments,
    opaque_walls_end_pixels_early,
    no_gaussians_and_none_in_front_of_the_camera,
    poison_is_culled_and_never_spreads,
    the_same_device_gives_the_same_bits_again,
    field,
    decoder_of_separate_and_shared_heads,
    photometric,
    ssim_of_three_and_four_channels,
    total_variation_of_both_kinds_by_mean_and_by_sum,
    adam_in_place_and_on_shared_memory,
    contributors,
);
