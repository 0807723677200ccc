//! Tests of the primitives against plain f64, on every device.

use super::reference::{Gaussian, GaussianAtTime, rotated};
use super::{ColourSeries, Gaussians4d, rotation_matrices};
use burn::module::Param;
use burn::tensor::{Device, Tensor, TensorData};
use volseggs_base::rng::{Purpose, Rng};
use volseggs_core::model::params::{sizes, to_vec};
use volseggs_kernels::PinholeCamera;
use volseggs_kernels::splat::reference::{Cutoffs, ReferenceScene, render};
use volseggs_kernels::splat::{Rendering, SplatInputs, SplatSettings, splat, splat_covariances};

/// Directional coefficients, and orders in time.
const SERIES: ColourSeries = ColourSeries { sh_stride: 4, time_degree: 2, duration: 1.3 };
const TIME: f32 = 0.4;

fn random(n: usize, seed: u64) -> Vec<Gaussian> {
    let mut r = Rng::new(seed, 0, Purpose::Custom(4));
    let mut next = |mean: f32, deviation: f32| f64::from(mean + deviation * r.normal());
    (0..n)
        .map(|_| Gaussian {
            mean: std::array::from_fn(|_| next(0.0, 0.3)),
            time: next(TIME, 0.1),
            log_scales: std::array::from_fn(|_| next(-1.2, 0.2)),
            left: std::array::from_fn(|_| next(0.0, 1.0)),
            right: std::array::from_fn(|_| next(0.0, 1.0)),
            opacity_logit: next(-0.5, 0.5),
            sh: (0..3 * 3 * SERIES.sh_stride).map(|_| next(0.0, 0.1)).collect(),
        })
        .collect()
}

fn module(of: &[Gaussian], device: &Device) -> Gaussians4d {
    let n = of.len();
    fn all<const D: usize>(
        rows: impl Iterator<Item = Vec<f64>>,
        shape: [usize; D],
        device: &Device,
    ) -> Param<Tensor<D>> {
        let values: Vec<f32> = rows.flatten().map(|v| v as f32).collect();
        Param::from_tensor(Tensor::from_data(TensorData::new(values, shape), device))
    }
    Gaussians4d {
        means: all(of.iter().map(|g| g.mean.to_vec()), [n, 3], device),
        times: all(of.iter().map(|g| vec![g.time]), [n], device),
        log_scales: all(of.iter().map(|g| g.log_scales.to_vec()), [n, 4], device),
        left: all(of.iter().map(|g| g.left.to_vec()), [n, 4], device),
        right: all(of.iter().map(|g| g.right.to_vec()), [n, 4], device),
        opacity_logits: all(of.iter().map(|g| vec![g.opacity_logit]), [n], device),
        sh: all(of.iter().map(|g| g.sh.clone()), [n, 3 * SERIES.sh_stride, 3], device),
    }
}

fn drawn(of: &[Gaussian]) -> Vec<GaussianAtTime> {
    let ColourSeries { sh_stride, time_degree, duration } = SERIES;
    of.iter().map(|g| g.at(f64::from(TIME), sh_stride, time_degree, f64::from(duration))).collect()
}

/// The parameters of a Gaussian in the order of [`Gaussians4d`].
fn numbers(g: &mut Gaussian) -> Vec<&mut f64> {
    let Gaussian { mean, time, log_scales, left, right, opacity_logit, sh } = g;
    let parts = mean.iter_mut().chain([time]).chain(log_scales).chain(left).chain(right);
    parts.chain([opacity_logit]).chain(sh).collect()
}

/// The gradient of `loss` by difference quotients of fourth order, one row per Gaussian.
fn quotients(of: &[Gaussian], loss: impl Fn(&[Gaussian]) -> f64) -> Vec<Vec<f64>> {
    const STEP: f64 = 1e-4;
    let mut moved = of.to_vec();
    let row = |i: usize, moved: &mut Vec<Gaussian>| -> Vec<f64> {
        let count = numbers(&mut moved[i]).len();
        (0..count)
            .map(|k| {
                let at = *numbers(&mut moved[i])[k];
                let mut by = |steps: f64| {
                    *numbers(&mut moved[i])[k] = at + steps * STEP;
                    loss(moved)
                };
                let (near, far) = (by(1.0) - by(-1.0), by(2.0) - by(-2.0));
                *numbers(&mut moved[i])[k] = at;
                (8.0 * near - far) / (12.0 * STEP)
            })
            .collect()
    };
    (0..of.len()).map(|i| row(i, &mut moved)).collect()
}

/// The gradients from autodiff, in the order of [`numbers`].
fn gradients(of: &Gaussians4d, loss: Tensor<1>) -> Vec<Vec<f64>> {
    let g = loss.backward();
    let columns = [
        to_vec(of.means.grad(&g).unwrap()),
        to_vec(of.times.grad(&g).unwrap()),
        to_vec(of.log_scales.grad(&g).unwrap()),
        to_vec(of.left.grad(&g).unwrap()),
        to_vec(of.right.grad(&g).unwrap()),
        to_vec(of.opacity_logits.grad(&g).unwrap()),
        to_vec(of.sh.grad(&g).unwrap()),
    ];
    let row = |i: usize| {
        columns.iter().flat_map(move |c| {
            let width = c.len() / of.count();
            c[i * width..][..width].iter().map(|&v| f64::from(v))
        })
    };
    (0..of.count()).map(|i| row(i).collect()).collect()
}

/// The largest error, in units of the root mean square of `exact`.
fn worst(ours: &[f64], exact: &[f64]) -> f64 {
    assert_eq!(ours.len(), exact.len());
    assert!(ours.iter().all(|v| v.is_finite()));
    let square = exact.iter().map(|v| v * v).sum::<f64>() / exact.len() as f64;
    ours.iter().zip(exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / square.sqrt()
}

fn wide<const D: usize>(tensor: Tensor<D>) -> Vec<f64> {
    to_vec(tensor).into_iter().map(f64::from).collect()
}

fn numbers_at_a_time_are_those_of_the_reference(device: Device) {
    let of = random(40, 1);
    let expected = drawn(&of);
    let module = module(&of, &device);
    let (at, moment) = (module.at_time(TIME, SERIES), module.moment(TIME));
    let column = |f: fn(&GaussianAtTime) -> Vec<f64>| expected.iter().flat_map(f).collect::<Vec<f64>>();
    for (name, ours, exact) in [
        ("means", wide(at.means), column(|d| d.mean.to_vec())),
        ("covariances", wide(at.covariances), column(|d| d.covariance.to_vec())),
        ("velocities", wide(moment.velocities), column(|d| d.velocity.to_vec())),
        ("marginals", wide(moment.log_marginals.exp()), column(|d| vec![d.marginal])),
        ("opacities", wide(at.opacity_logits), column(|d| vec![d.opacity_logit])),
        ("sh", wide(at.sh), column(|d| d.sh.clone())),
    ] {
        let error = worst(&ours, &exact);
        println!("{name}: {error:.1e}");
        assert!(error < 1e-5, "{name}: off by {error:.1e}");
    }
}

/// Velocities have no gradient here, as nothing is drawn from them.
fn gradients_of_what_is_drawn_are_difference_quotients(device: Device) {
    let of = random(10, 2);
    let device = device.autodiff();
    let mut r = Rng::new(3, 0, Purpose::Custom(5));
    let mut weights = |n: usize| -> Vec<f32> { (0..n).map(|_| r.normal()).collect() };
    let weights = [3, 6, 1, 3 * SERIES.sh_stride].map(|width| weights(of.len() * width));
    let at = module(&of, &device);
    let loss = {
        let at = at.at_time(TIME, SERIES);
        let term = |values: Tensor<1>, w: &[f32]| (values * Tensor::from_data(w, &device)).sum();
        let flat = |n: usize| [of.len() * n];
        term(at.means.reshape(flat(3)), &weights[0])
            + term(at.covariances.reshape(flat(6)), &weights[1])
            + term(at.opacity_logits, &weights[2])
            + term(at.sh.reshape(flat(3 * SERIES.sh_stride)), &weights[3])
    };
    let exact = quotients(&of, |of| {
        let weighted = |values: &[f64], w: &[f32], i: usize| -> f64 {
            values.iter().zip(&w[i * values.len()..]).map(|(v, w)| v * f64::from(*w)).sum()
        };
        let of_one = |(i, d): (usize, &GaussianAtTime)| {
            weighted(&d.mean, &weights[0], i)
                + weighted(&d.covariance, &weights[1], i)
                + weighted(&[d.opacity_logit], &weights[2], i)
                + weighted(&d.sh, &weights[3], i)
        };
        drawn(of).iter().enumerate().map(of_one).sum()
    });
    for (ours, exact) in gradients(&at, loss).iter().zip(&exact) {
        let error = worst(ours, exact);
        println!("{error:.1e}");
        assert!(error < 1e-4, "off by {error:.1e}: {ours:?} for {exact:?}");
    }
}

fn settings() -> SplatSettings {
    let camera = PinholeCamera {
        width: 21,
        height: 17,
        fx: 39.0,
        fy: 41.0,
        cx: 10.8,
        cy: 8.3,
        rotation: [[0.96, 0.0, -0.28], [0.0, 1.0, 0.0], [0.28, 0.0, 0.96]],
        translation: [0.05, -0.1, 4.0],
    };
    Rendering { background: [0.1, 0.2, 0.3], sh_degree: 1, ..Rendering::default() }.seen_by(camera)
}

/// The image in f64, from the f64 primitives.
fn picture(of: &[Gaussian], cutoffs: Cutoffs) -> Vec<f64> {
    let drawn = drawn(of);
    let column = |f: fn(&GaussianAtTime) -> Vec<f64>| drawn.iter().flat_map(f).collect::<Vec<f64>>();
    let scene = ReferenceScene {
        means: column(|d| d.mean.to_vec()),
        rotations: vec![0.0; 4 * of.len()],
        log_scales: vec![0.0; 3 * of.len()],
        covariances: column(|d| d.covariance.to_vec()),
        opacity_logits: column(|d| vec![d.opacity_logit]),
        sh: column(|d| d.sh.clone()),
        sh_stride: SERIES.sh_stride,
        screen_offsets: vec![0.0; 2 * of.len()],
    };
    render(&scene, &settings(), cutoffs)
}

/// From the parameters to the loss of an image, and back.
fn gradients_of_a_picture_are_difference_quotients(device: Device) {
    let mut of = random(8, 6);
    // so large that each is visible everywhere
    of.iter_mut().flat_map(|g| &mut g.log_scales).for_each(|s| *s += 1.2);
    assert_eq!(picture(&of, Cutoffs::OP), picture(&of, Cutoffs::NONE), "a cutoff has an effect");
    let gpu = volseggs_core::device::runs_ahead(&device);
    let device = device.autodiff();
    let mut r = Rng::new(8, 0, Purpose::Custom(7));
    let weights: Vec<f32> = (0..21 * 17 * 4).map(|_| r.normal()).collect();
    let module = module(&of, &device);
    let image = splat_covariances(module.at_time(TIME, SERIES), settings()).image;
    let off = worst(&wide(image.clone().inner()), &picture(&of, Cutoffs::OP));
    println!("image: {off:.1e}");
    assert!(off < 1e-4, "the image is off by {off:.1e}");
    let by_image = Tensor::<3>::from_data(TensorData::new(weights.clone(), [17, 21, 4]), &device);
    let ours = gradients(&module, (image * by_image).sum());
    let exact =
        quotients(&of, |of| picture(of, Cutoffs::OP).iter().zip(&weights).map(|(v, w)| v * f64::from(*w)).sum());
    for (ours, exact) in ours.iter().zip(&exact) {
        let error = worst(ours, exact);
        println!("{error:.1e}");
        assert!(error < if gpu { 5e-3 } else { 2e-4 }, "off by {error:.1e}: {ours:?} for {exact:?}");
    }
}

/// Equal quaternions leave time unchanged: nothing moves, and what is drawn is a three-dimensional Gaussian.
fn equal_quaternions_turn_space_alone(device: Device) {
    let mut of = random(8, 9);
    for g in &mut of {
        g.right = g.left;
        g.time = f64::from(TIME);
        g.sh[3 * SERIES.sh_stride..].fill(0.0);
    }
    let module = module(&of, &device);
    let moment = module.moment(TIME);
    assert!(wide(moment.velocities).iter().all(|v| v.abs() < 1e-6));
    assert_eq!(wide(moment.means), wide(module.means.val()));
    let at = module.at_time(TIME, SERIES);
    let opacities = worst(&wide(at.opacity_logits.clone()), &wide(module.opacity_logits.val()));
    assert!(opacities < 1e-6, "at its peak a Gaussian has its whole opacity, off by {opacities:.1e}");
    // i, j, k stand for z, y, x, which is a reflection: the axis is negated
    let rotations = of.iter().flat_map(|g| [g.left[0], -g.left[3], -g.left[2], -g.left[1]].map(|v| v as f32));
    let log_scales = of.iter().flat_map(|g| g.log_scales[..3].iter().map(|&v| v as f32).collect::<Vec<_>>());
    let rows = |values: Vec<f32>, width| Tensor::<2>::from_data(TensorData::new(values, [of.len(), width]), &device);
    let (rotations, log_scales) = (rows(rotations.collect(), 4), rows(log_scales.collect(), 3));
    let (means, opacity_logits) = (module.means.val(), module.opacity_logits.val());
    let three = SplatInputs::new(means, rotations, log_scales, opacity_logits, at.sh.clone());
    let off = worst(&wide(splat_covariances(at, settings()).image), &wide(splat(three, settings()).image));
    println!("{off:.1e}");
    assert!(off < 1e-4, "off by {off:.1e}");
}

/// Extreme finite values leave finite gradients; a non-finite Gaussian is not drawn and does not affect the others.
fn extremes_spread_no_nan(device: Device) {
    let clean = random(5, 10);
    let device = device.autodiff();
    let run = |of: &[Gaussian]| {
        let module = module(of, &device);
        let image = splat_covariances(module.at_time(TIME, SERIES), settings()).image;
        (wide(image.clone().inner()), gradients(&module, image.sum()))
    };
    let mut without = clean.clone();
    without[2].opacity_logit = -1e4;
    let (expected, expected_gradients) = run(&without);
    // all parameters, but only one of the colours
    for (k, value) in (0..18).flat_map(|k| [f64::NAN, f64::INFINITY, f64::NEG_INFINITY].map(|v| (k, v))) {
        let mut of = clean.clone();
        *numbers(&mut of[2])[k] = value;
        let (image, gradients) = run(&of);
        assert!(image.iter().all(|v| v.is_finite()), "{value} as value {k}");
        for i in [0, 1, 3, 4] {
            assert!(gradients[i].iter().all(|v| v.is_finite()), "{value} as value {k}: gradient of {i}");
        }
        if value.is_nan() && k < 17 {
            assert_eq!(image, expected, "NaN as value {k} is drawn");
            assert_eq!(gradients[0], expected_gradients[0], "NaN as value {k}");
        }
    }
    let far: [fn(&mut Gaussian); 8] = [
        |g| g.right = g.left,
        |g| g.left = [0.0; 4],
        |g| g.right = [0.0; 4],
        |g| g.log_scales = [-60.0; 4],
        |g| g.log_scales = [20.0; 4],
        |g| g.time = 1e6,
        |g| g.opacity_logit = 100.0,
        |g| g.opacity_logit = -100.0,
    ];
    for (k, change) in far.iter().enumerate() {
        for last in [-60.0, -30.0, -10.0] {
            let mut of = clean.clone();
            of[2].log_scales[3] = last;
            change(&mut of[2]);
            let (image, gradients) = run(&of);
            assert!(image.iter().all(|v| v.is_finite()), "change {k}");
            assert!(gradients.iter().flatten().all(|v| v.is_finite()), "change {k}, {last}: {:?}", gradients[2]);
        }
    }
}

fn marginals_below_a_twentieth_are_not_drawn(device: Device) {
    let mut of = random(2, 11);
    for g in &mut of {
        (g.right, g.opacity_logit) = (g.left, 3.0);
    }
    let deviation = of[0].log_scales[3].exp();
    // a marginal of 0.06, and one of 0.04
    for (marginal, seen) in [(0.06f64, true), (0.04, false)] {
        of[0].time = f64::from(TIME) + deviation * (-2.0 * marginal.ln()).sqrt();
        let at = module(&of[..1], &device).at_time(TIME, SERIES);
        let logit = wide(at.opacity_logits)[0];
        let opacity = 1.0 / (1.0 + (-logit).exp());
        let whole = 1.0 / (1.0 + (-3.0f64).exp());
        let expected = if seen { marginal * whole } else { 0.0 };
        assert!((opacity - expected).abs() < 1e-5, "{opacity} for {expected}");
    }
}

fn rotations_are_products_of_quaternions(device: Device) {
    let of = random(20, 12);
    let module = module(&of, &device);
    let matrices = wide(rotation_matrices(module.left.val(), module.right.val()));
    for (g, matrix) in of.iter().zip(matrices.chunks_exact(16)) {
        for column in 0..4 {
            let axis = std::array::from_fn(|k| f64::from(u8::from(k == column)));
            for (row, exact) in rotated(axis, g.left, g.right).into_iter().enumerate() {
                assert!((matrix[4 * row + column] - exact).abs() < 1e-6);
            }
        }
    }
}

#[test]
fn a_gaussian_with_all_its_colours_has_161_numbers() {
    let device = volseggs_core::device::DeviceName::all()[0].open().unwrap();
    let mut module = module(&random(3, 13), &device);
    module.sh = Param::from_tensor(Tensor::zeros([3, 48, 3], &device));
    assert_eq!(sizes(&module).values().sum::<usize>(), 3 * 161);
}

volseggs_testing::on_every_device!(
    crate::test_support::open_to_test =>
    numbers_at_a_time_are_those_of_the_reference,
    gradients_of_what_is_drawn_are_difference_quotients,
    gradients_of_a_picture_are_difference_quotients,
    equal_quaternions_turn_space_alone,
    extremes_spread_no_nan,
    marginals_below_a_twentieth_are_not_drawn,
    rotations_are_products_of_quaternions,
);
