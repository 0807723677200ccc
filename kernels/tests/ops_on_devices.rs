//! Field, changes by attribute, SSIM, distance, total variation, rays, sines and Adam as tensor ops: the gradients that
//! autodiff returns match those of the f64 references, and all CPU devices give the same bits.
#![allow(missing_docs, clippy::unwrap_used)]

mod common;

use burn::tensor::{Device, Tensor, TensorData};
use common::{Numbers, Tested, relative_error, to_vec};
use volseggs_kernels::adam::{AdamStep, AdamTensors, NonFinite, adam};
use volseggs_kernels::changes::{COLUMNS, WIDTHS, split_changes};
use volseggs_kernels::decoder::{DecoderShape, DecoderWeights, decoder};
use volseggs_kernels::field::{FieldShape, LevelShape, field, reference as field_reference};
use volseggs_kernels::march::{RaySamples, composite, reference as march_reference};
use volseggs_kernels::photometric::{Distance, photometric_loss, reference as photometric_reference};
use volseggs_kernels::sine::sine;
use volseggs_kernels::ssim::{mean_ssim, reference as ssim_reference};
use volseggs_kernels::tv::{DifferenceReduction, TvKind, TvWeights, reference as tv_reference, total_variation};

fn values(n: usize, seed: u64) -> Vec<f32> {
    let mut r = Numbers(seed);
    (0..n).map(|_| r.next() as f32).collect()
}

fn wide(v: &[f32]) -> Vec<f64> {
    v.iter().map(|&x| f64::from(x)).collect()
}

fn tensor<const D: usize>(v: &[f32], shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(v.to_vec(), shape), device)
}

fn shape() -> FieldShape {
    let levels = vec![LevelShape { resolution: [5, 6, 7] }, LevelShape { resolution: [9, 4, 8] }];
    FieldShape { levels, time_knots: 4, channels: 8 }
}

fn field_gradients_match_the_reference(on: Tested) {
    let shape = shape();
    let n = 40;
    let (planes, lines) = (values(shape.planes_len(), 1), values(shape.lines_len(), 2));
    let (times, weights) = (values(shape.times_len(), 3), values(n * shape.features_len(), 4));
    let points: Vec<f32> = values(3 * n, 5).iter().map(|v| 1.9 * v - 0.95).collect();
    let ours = on.results(|device| {
        let p = tensor(&planes, [planes.len()], device).require_grad();
        let l = tensor(&lines, [lines.len()], device).require_grad();
        let t = tensor(&times, [times.len()], device).require_grad();
        let x = tensor(&points, [n, 3], device).require_grad();
        let out = field(p.clone(), l.clone(), t.clone(), x.clone(), &shape, 0.37);
        let g = (out.clone() * tensor(&weights, out.dims(), device)).sum().backward();
        vec![
            to_vec(out.inner()),
            to_vec(p.grad(&g).unwrap()),
            to_vec(l.grad(&g).unwrap()),
            to_vec(t.grad(&g).unwrap()),
            to_vec(x.grad(&g).unwrap()),
        ]
    });
    let (planes, lines, times) = (wide(&planes), wide(&lines), wide(&times));
    let params = field_reference::FieldParamsF64 { planes: &planes, lines: &lines, times: &times };
    let time = f64::from(0.37f32);
    let tolerance = on.within(1e-5, 1e-4);
    assert!(relative_error(&ours[0], &field_reference::forward(&shape, params, &wide(&points), time)) < tolerance);
    let g = field_reference::backward(&shape, params, &wide(&points), time, &wide(&weights));
    for (ours, expected) in ours[1..].iter().zip([&g.planes, &g.lines, &g.times, &g.points]) {
        assert!(relative_error(ours, expected) < tolerance);
    }
}

fn changes_are_split_by_attribute_and_their_gradients_joined(on: Tested) {
    let n = 8192 + 37; // more than one task on a CPU
    let (changes, weights) = (values(COLUMNS * n, 31), values(COLUMNS * n, 32));
    let mut first = [0; 4];
    for k in 1..4 {
        first[k] = first[k - 1] + WIDTHS[k - 1];
    }
    let of = |all: &[f32], k: usize| -> Vec<f32> {
        all.chunks_exact(COLUMNS).flat_map(|row| row[first[k]..first[k] + WIDTHS[k]].to_vec()).collect()
    };
    // how often each attribute is used: once, not at all, twice
    for used in [[1, 1, 1, 1], [1, 0, 2, 0], [0, 0, 0, 3]] {
        let ours = on.results(|device| {
            let x = tensor(&changes, [n, COLUMNS], device).require_grad();
            let parts = split_changes(x.clone());
            let mut loss = Tensor::<1>::zeros([1], device);
            for k in 0..4 {
                for _ in 0..used[k] {
                    loss = loss + (parts[k].clone() * tensor(&of(&weights, k), [n, WIDTHS[k]], device)).sum();
                }
            }
            let g = loss.backward();
            let parts = parts.map(|part| to_vec(part.inner()));
            parts.into_iter().chain([to_vec(x.grad(&g).unwrap())]).collect()
        });
        for k in 0..4 {
            assert_eq!(ours[k], of(&changes, k), "attribute {k}");
            let expected: Vec<f32> = of(&weights, k).iter().map(|w| w * used[k] as f32).collect();
            assert!(relative_error(&of(&ours[4], k), &wide(&expected)) < 1e-6, "gradient of {k}, {used:?}");
        }
    }
    // without a gradient, and without rows
    let plain = split_changes(tensor(&changes, [n, COLUMNS], &on.device));
    assert_eq!(to_vec(plain[2].clone()), of(&changes, 2));
    assert_eq!(split_changes(tensor(&[], [0, COLUMNS], &on.device)).map(|part| part.dims()), WIDTHS.map(|w| [0, w]));
}

fn ssim_and_its_gradient_match_the_reference(on: Tested) {
    let (h, w) = (19, 23);
    let (a, b) = (values(3 * h * w, 6), values(3 * h * w, 7));
    let ours = on.results(|device| {
        let x = tensor(&a, [h, w, 3], device).require_grad();
        let s = mean_ssim(x.clone(), tensor(&b, [h, w, 3], device));
        let g = s.clone().mul_scalar(2.0).backward();
        vec![to_vec(s.inner()), to_vec(x.grad(&g).unwrap())]
    });
    let (value, gradient) = ssim_reference::ssim_grad(&wide(&a), &wide(&b), h, w);
    assert!((f64::from(ours[0][0]) - value).abs() < on.within(1e-5, 1e-4));
    let doubled: Vec<f64> = gradient.iter().map(|g| 2.0 * g).collect();
    assert!(relative_error(&ours[1], &doubled) < on.within(1e-5, 2e-3));
}

fn ssim_ignores_a_fourth_channel(on: Tested) {
    let (h, w) = (19, 23);
    let (a, b) = (values(4 * h * w, 6), values(4 * h * w, 7));
    let rgb = |v: &[f32]| v.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect::<Vec<_>>();
    let run = |a: &[f32], b: &[f32], channels: usize, device: &Device| {
        let x = tensor(a, [h, w, channels], device).require_grad();
        let s = mean_ssim(x.clone(), tensor(b, [h, w, channels], device));
        let g = s.clone().backward();
        vec![to_vec(s.inner()), to_vec(x.grad(&g).unwrap())]
    };
    let four = on.results(|device| run(&a, &b, 4, device));
    let three = on.results(|device| run(&rgb(&a), &rgb(&b), 3, device));
    assert_eq!((&four[0], rgb(&four[1])), (&three[0], three[1].clone()));
    assert!(four[1].chunks_exact(4).all(|p| p[3] == 0.0));
}

fn photometric_losses_and_their_gradients_match_the_reference(on: Tested) {
    let (h, w) = (17, 21);
    let (a, b) = (values(4 * h * w, 16), values(4 * h * w, 17));
    for kind in [Distance::Absolute, Distance::Squared] {
        let ours = on.results(|device| {
            let x = tensor(&a, [h, w, 4], device).require_grad();
            let out = photometric_loss(x.clone(), tensor(&b, [h, w, 4], device), kind, 0.2);
            let g = out.loss.clone().mul_scalar(2.0).backward();
            vec![to_vec(out.loss.inner()), to_vec(out.squared.inner()), to_vec(x.grad(&g).unwrap())]
        });
        let (value, gradient, squared) =
            photometric_reference::photometric(&wide(&a), &wide(&b), kind, f64::from(0.2f32));
        let tolerance = on.within(1e-6, 1e-5);
        assert!(
            (f64::from(ours[0][0]) - value).abs() < tolerance && (f64::from(ours[1][0]) - squared).abs() < tolerance
        );
        let doubled: Vec<f64> = gradient.iter().map(|g| 2.0 * g).collect();
        assert!(relative_error(&ours[2], &doubled) < tolerance);
    }
}

fn total_variation_and_its_gradients_match_the_reference(on: Tested) {
    let shape = shape();
    let parameters = [values(shape.planes_len(), 8), values(shape.lines_len(), 9), values(shape.times_len(), 10)];
    let spans = [shape.plane_spans(), shape.line_spans(), shape.time_spans()];
    let (mean, sum) = (DifferenceReduction::Mean, DifferenceReduction::Sum);
    for (kind, reduction) in
        [(TvKind::First, mean), (TvKind::First, sum), (TvKind::Second, mean), (TvKind::Second, sum)]
    {
        let weights = TvWeights { space: 1.0, time: 0.5, one_prior_space: 0.25, one_prior_time: 2.0, reduction };
        let ours = on.results(|device| {
            let [p, l, t] = parameters.each_ref().map(|v| tensor::<1>(v, [v.len()], device).require_grad());
            let v = total_variation(p.clone(), l.clone(), t.clone(), &shape, kind, weights);
            let g = v.clone().mul_scalar(2.0).backward();
            let slopes = [p, l, t].map(|x| to_vec(x.grad(&g).unwrap()));
            std::iter::once(to_vec(v.inner())).chain(slopes).collect()
        });
        let tolerance = on.within(1e-6, 1e-5);
        let mut value = 0.0;
        let (space, time) = ((weights.space, weights.one_prior_space), (weights.time, weights.one_prior_time));
        for (k, (weight, prior)) in [space, space, time].into_iter().enumerate() {
            let (weight, prior) = (f64::from(weight), f64::from(prior));
            let data = wide(&parameters[k]);
            let mut gradient = vec![0.0; data.len()];
            value += tv_reference::tv(&data, &spans[k], shape.channels, kind, reduction, weight, prior, &mut gradient);
            let doubled: Vec<f64> = gradient.iter().map(|g| 2.0 * g).collect();
            assert!(relative_error(&ours[k + 1], &doubled) < tolerance);
        }
        assert!((f64::from(ours[0][0]) - value).abs() < tolerance * value, "{} against {value}", ours[0][0]);
    }
}

fn composited_rays_and_their_gradients_match_the_reference(on: Tested) {
    let offsets: Vec<u32> = (0..=90).map(|ray: u32| ray * (ray + 5) / 6).collect();
    let samples = offsets[90] as usize;
    let coloured: Vec<bool> = values(samples, 18).iter().map(|v| *v < 0.7).collect();
    let rays = RaySamples::new(&offsets, &coloured);
    let depths: Vec<f32> = values(samples, 19).iter().map(|v| 0.4 * v * v).collect();
    let (colours, weights) = (values(3 * rays.coloured(), 20), values(4 * 90, 21));
    let back = [0.9f32, 0.2, 0.6];
    let ours = on.results(|device| {
        let d = tensor(&depths, [samples], device).require_grad();
        let c = tensor(&colours, [rays.coloured(), 3], device).require_grad();
        let out = composite(d.clone(), c.clone(), &rays, back);
        let g = (out.clone() * tensor(&weights, [90, 4], device)).sum().backward();
        vec![to_vec(out.inner()), to_vec(d.grad(&g).unwrap()), to_vec(c.grad(&g).unwrap())]
    });
    let of = |depths: &[f64], colours: &[f64]| march_reference::composite(&rays, depths, colours, back.map(f64::from));
    let (mut d, mut c) = (wide(&depths), wide(&colours));
    let tolerance = on.within(1e-5, 1e-4);
    assert!(relative_error(&ours[0], &of(&d, &c)) < tolerance);
    let total = |out: Vec<f64>| out.iter().zip(&weights).map(|(v, w)| v * f64::from(*w)).sum::<f64>();
    let h = 1e-5;
    let mut of_depths = Vec::new();
    for i in 0..d.len() {
        let at = d[i];
        d[i] = at + h;
        let up = total(of(&d, &c));
        d[i] = at - h;
        of_depths.push((up - total(of(&d, &c))) / (2.0 * h));
        d[i] = at;
    }
    assert!(relative_error(&ours[1], &of_depths) < tolerance);
    // linear in the colours
    let dark = vec![0.0; c.len()];
    let black = total(of(&d, &dark));
    let of_colours: Vec<f64> = (0..c.len())
        .map(|i| {
            c.fill(0.0);
            c[i] = 1.0;
            total(of(&d, &c)) - black
        })
        .collect();
    assert!(relative_error(&ours[2], &of_colours) < tolerance);
}

fn sines_of_rows_and_their_gradients_match_double_precision(on: Tested) {
    let (n, width, omega) = (37, 24, 30.0f32);
    let (x, bias, weights) = (values(n * width, 22), values(width, 23), values(n * width, 24));
    let ours = on.results(|device| {
        let rows = tensor(&x, [n, width], device).require_grad();
        let b = tensor(&bias, [width], device).require_grad();
        let out = sine(rows.clone(), b.clone(), omega);
        let g = (out.clone() * tensor(&weights, [n, width], device)).sum().backward();
        vec![to_vec(out.inner()), to_vec(rows.grad(&g).unwrap()), to_vec(b.grad(&g).unwrap())]
    });
    let argument = |i: usize| f64::from(omega * (x[i] + bias[i % width]));
    let exact: Vec<f64> = (0..n * width).map(|i| argument(i).sin()).collect();
    let slope = |i: usize| f64::from(omega) * argument(i).cos() * f64::from(weights[i]);
    let of_rows: Vec<f64> = (0..n * width).map(slope).collect();
    let of_bias: Vec<f64> = (0..width).map(|c| of_rows.iter().skip(c).step_by(width).sum()).collect();
    let tolerance = on.within(1e-6, 1e-4);
    for (ours, expected) in ours.iter().zip([&exact, &of_rows, &of_bias]) {
        assert!(relative_error(ours, expected) < tolerance);
    }
}

const STEP: AdamStep = AdamStep {
    lr: 0.1,
    beta1: 0.9,
    beta2: 0.999,
    eps: 1e-15,
    bias_correction1: 0.1,
    bias_correction2: 0.001,
    lr_pattern: None,
};

/// Runs one step from zero moments.
fn stepped(device: &Device, param: &[f32], gradient: &[f32]) -> (Vec<f32>, Option<NonFinite>) {
    let n = param.len();
    let tensors = AdamTensors {
        param: tensor(param, [n], device),
        moment_1: Tensor::<1>::zeros([n], device),
        moment_2: Tensor::<1>::zeros([n], device),
    };
    let (out, bad) = adam(tensors, tensor(gradient, [n], device), STEP);
    (to_vec(out.param), bad)
}

fn the_first_step_of_adam_moves_every_element_by_the_rate(on: Tested) {
    let (out, bad) = stepped(&on.device, &[1.0, 2.0], &[3.0, -4.0]);
    assert_eq!(bad, None);
    // against its gradient
    assert!(out.iter().zip([0.9f32, 2.1]).all(|(v, expected)| (v - expected).abs() < 1e-5), "{out:?}");
}

/// A GPU's kernels would read other values without an error.
fn tensors_of_other_shapes_are_refused(on: Tested) {
    let device = &on.device;
    let panics = |work: &dyn Fn()| std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).is_err();
    let zeros = |n: usize| Tensor::<1>::zeros([n], device);
    let shape = shape();
    let lens = [shape.planes_len(), shape.lines_len(), shape.times_len()];
    let points = Tensor::<2>::zeros([4, 3], device);
    let of = |[p, l, t]: [usize; 3]| drop(field(zeros(p), zeros(l), zeros(t), points.clone(), &shape, 0.5));
    let reduction = DifferenceReduction::Mean;
    let weights = TvWeights { space: 1.0, time: 1.0, one_prior_space: 0.0, one_prior_time: 0.0, reduction };
    let tv = |[p, l, t]: [usize; 3]| {
        drop(total_variation(zeros(p), zeros(l), zeros(t), &shape, TvKind::First, weights));
    };
    assert!(!panics(&|| of(lens)) && !panics(&|| tv(lens)));
    for i in 0..3 {
        let mut other = lens;
        other[i] -= 1;
        assert!(panics(&|| of(other)) && panics(&|| tv(other)), "{i}");
    }
    let adam_of = |n: usize| {
        let tensors = AdamTensors { param: zeros(4), moment_1: zeros(n), moment_2: zeros(4) };
        drop(adam(tensors, zeros(4), STEP));
    };
    assert!(!panics(&|| adam_of(4)) && panics(&|| adam_of(3)));

    let shape = DecoderShape { inputs: 4, width: 8, head_sizes: vec![3, 1] };
    let matrix = |[rows, columns]: [usize; 2]| Tensor::<2>::zeros([rows, columns], device);
    let decoded = |x: [usize; 2], own: Option<[usize; 2]>, trunk: [usize; 2]| {
        let weights = DecoderWeights {
            trunk: (matrix(trunk), zeros(8)),
            hidden: (matrix([8, 16]), zeros(16)),
            output: (matrix([8, 4]), zeros(4)),
        };
        drop(decoder(matrix(x), own.map(matrix), weights, &shape));
    };
    assert!(!panics(&|| decoded([10, 4], None, [4, 8])) && !panics(&|| decoded([10, 3], Some([10, 1]), [4, 8])));
    assert!(panics(&|| decoded([10, 8], None, [4, 8])) && panics(&|| decoded([10, 4], None, [8, 4])));
    assert!(panics(&|| decoded([10, 3], Some([10, 2]), [4, 8])) && panics(&|| decoded([10, 3], Some([9, 1]), [4, 8])));
    assert!(panics(&|| decoded([10, 1], Some([10, 5]), [4, 8])), "wider than all inputs");
}

/// GPUs do not check this, as reporting it to the host would stall every step.
fn adam_reports_non_finite_values(on: Tested) {
    let found = stepped(&on.device, &[1.0, 2.0], &[3.0, f32::NAN]);
    assert_eq!(found, (vec![1.0, 2.0], Some(NonFinite::Gradient(1))));
    let (_, bad) = stepped(&on.device, &[f32::INFINITY, 2.0], &[3.0, 1.0]);
    assert_eq!(bad, Some(NonFinite::Parameter(0)));
}

volseggs_testing::on_every_device!(
    crate::common::open =>
    field_gradients_match_the_reference,
    changes_are_split_by_attribute_and_their_gradients_joined,
    ssim_and_its_gradient_match_the_reference,
    photometric_losses_and_their_gradients_match_the_reference,
    total_variation_and_its_gradients_match_the_reference,
    sines_of_rows_and_their_gradients_match_double_precision,
    composited_rays_and_their_gradients_match_the_reference,
    the_first_step_of_adam_moves_every_element_by_the_rate,
    tensors_of_other_shapes_are_refused,
);
volseggs_testing::on_every_cpu_device!(
    crate::common::open => ssim_ignores_a_fourth_channel, adam_reports_non_finite_values,
);
