//! Splatting by covariances against splatting by rotations and scales, and inputs that are not covariances. Values,
//! gradients and poison entry by entry are tested with those of the other kind in splat_golden.rs, splat_gradients.rs,
//! splat_behaviour.rs and gpu_parity.rs.
#![allow(missing_docs, clippy::unwrap_used)]

mod common;

use burn::tensor::{Tensor, TensorData};
use common::{Numbers, Tested, by_covariances, camera, fields, random_scene, relative_error, settings, to_vec};
use volseggs_kernels::splat::{CovarianceInputs, splat, splat_covariances};

fn weights(len: usize, seed: u64) -> Vec<f32> {
    let mut r = Numbers(seed);
    (0..len).map(|_| r.normal() as f32).collect()
}

/// Returns the entries `[N, 6]` of `R S S^T R^T`.
fn covariances(rotations: Tensor<2>, log_scales: Tensor<2>) -> Tensor<2> {
    let length = rotations.clone().powi_scalar(2).sum_dim(1).sqrt();
    let [w, x, y, z] = columns(rotations / length);
    let scales = columns::<3>(log_scales.exp());
    let twice = |a: &Tensor<2>, b: &Tensor<2>| a.clone() * b.clone() * 2.0;
    let rotation = [
        [1.0 - twice(&y, &y) - twice(&z, &z), twice(&x, &y) - twice(&w, &z), twice(&x, &z) + twice(&w, &y)],
        [twice(&x, &y) + twice(&w, &z), 1.0 - twice(&x, &x) - twice(&z, &z), twice(&y, &z) - twice(&w, &x)],
        [twice(&x, &z) - twice(&w, &y), twice(&y, &z) + twice(&w, &x), 1.0 - twice(&x, &x) - twice(&y, &y)],
    ];
    let scaled = rotation.map(|row| {
        let entries: Vec<_> = row.into_iter().zip(scales.clone()).map(|(r, s)| r * s).collect();
        Tensor::cat(entries, 1)
    });
    let places = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
    let entries = places.map(|(a, b)| (scaled[a].clone() * scaled[b].clone()).sum_dim(1));
    Tensor::cat(entries.to_vec(), 1)
}

/// Returns the columns `[N, 1]` of `[N, K]`.
fn columns<const K: usize>(of: Tensor<2>) -> [Tensor<2>; K] {
    let n = of.dims()[0];
    std::array::from_fn(|k| of.clone().slice([0..n, k..k + 1]))
}

/// A covariance computed from a rotation and scales gives the same image as these, and the same gradients with respect
/// to them.
fn covariances_match_rotations_and_scales(on: Tested) {
    let scene = random_scene(300, 2, 29);
    let s = settings(camera(60, 50), 2);
    let device = on.device.clone().autodiff();
    let weights = Tensor::<3>::from_data(TensorData::new(weights(60 * 50 * 4, 7), [50, 60, 4]), &device);
    let run = |by_covariances: bool| {
        let i = common::require_grad(common::inputs(&scene, &device));
        let out = if by_covariances {
            let of = i.clone();
            let covariances = covariances(of.rotations, of.log_scales);
            let (means, opacity_logits, sh) = (of.means, of.opacity_logits, of.sh);
            let screen_offsets = of.screen_offsets;
            splat_covariances(CovarianceInputs { means, covariances, opacity_logits, sh, screen_offsets }, s)
        } else {
            splat(i.clone(), s)
        };
        let g = (out.image.clone() * weights.clone()).sum().backward();
        let radii = out.radii.into_data().convert::<i32>().try_into_vec::<i32>().unwrap();
        let gradients = [
            ("means", to_vec(i.means.grad(&g).unwrap())),
            ("rotations", to_vec(i.rotations.grad(&g).unwrap())),
            ("log_scales", to_vec(i.log_scales.grad(&g).unwrap())),
            ("opacity_logits", to_vec(i.opacity_logits.grad(&g).unwrap())),
            ("sh", to_vec(i.sh.grad(&g).unwrap())),
            ("screen_offsets", to_vec(i.screen_offsets.unwrap().grad(&g).unwrap())),
        ];
        (to_vec(out.image.inner()), radii, gradients)
    };
    let (ours, expected) = (run(true), run(false));
    let worst = ours.0.iter().zip(&expected.0).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    println!("{}: image {worst:.1e}", on.name);
    assert!(worst < 1e-4, "{worst:.1e}");
    // rounded up from numbers that differ in their last bits
    assert!(ours.1.iter().zip(&expected.1).all(|(a, b)| (a - b).abs() <= 1));
    for ((name, ours), (_, expected)) in ours.2.iter().zip(&expected.2) {
        let expected: Vec<f64> = expected.iter().map(|&v| f64::from(v)).collect();
        let error = relative_error(ours, &expected);
        println!("{}: {name} {error:.1e}", on.name);
        assert!(error < on.within(2e-5, 2e-3), "{name}: off by {error:.1e} of the norm");
    }
}

/// The image is that of the scene without the Gaussian, whose own gradient is zero.
fn invalid_covariances_are_culled(on: Tested) {
    let s = settings(camera(40, 30), 1);
    let w = weights(40 * 30 * 4, 4);
    let clean = by_covariances(random_scene(40, 1, 23));
    let mut without = clean.clone();
    without.opacity_logits[3] = -1e4;
    let (expected, _) = common::gradients(&without, s, &w, &on.device);
    let (whole, _) = common::gradients(&clean, s, &w, &on.device);
    assert_ne!(whole, expected, "the Gaussian is visible");
    let (small, nan, infinite) = (0.01, f64::NAN, f64::INFINITY);
    for bad in [
        [-small, 0.0, 0.0, small, 0.0, small],
        [small, 2.0 * small, 0.0, small, 0.0, small],
        [small, 0.0, 0.0, small, -2.0 * small, small],
        [small, -0.9 * small, -0.9 * small, small, -0.9 * small, small],
        [small, 0.0, 0.0, 0.0, 0.1 * small, small],
        [-small, 0.0, 0.0, -small, 0.0, -small],
        [nan, 0.0, 0.0, small, 0.0, small],
        [small, 0.0, nan, small, 0.0, small],
        [infinite, 0.0, 0.0, infinite, 0.0, infinite],
        [small, 0.0, 0.0, small, infinite, small],
        [f64::NEG_INFINITY, 0.0, 0.0, small, 0.0, small],
    ] {
        let mut scene = clean.clone();
        scene.covariances[18..24].copy_from_slice(&bad);
        let (image, gradients) = common::gradients(&scene, s, &w, &on.device);
        assert_eq!(image, expected, "{bad:?}");
        for ((name, _), of) in fields(&scene).iter().zip(&gradients) {
            assert!(of.iter().all(|v| v.is_finite()), "{bad:?}: {name}");
            assert!(
                of[of.len() / 40 * 3..][..of.len() / 40].iter().all(|v| *v == 0.0),
                "{bad:?}: {name} of the culled Gaussian"
            );
        }
    }
    // a point, a line and a disc are covariances
    for flat in [[0.0; 6], [small, small, 0.0, small, 0.0, 0.0], [small, 0.0, 0.0, small, 0.0, 0.0]] {
        let mut scene = clean.clone();
        scene.covariances[18..24].copy_from_slice(&flat);
        let (image, gradients) = common::gradients(&scene, s, &w, &on.device);
        assert_ne!(image, expected, "{flat:?} is not visible");
        assert!(gradients.iter().flatten().all(|v| v.is_finite()));
    }
}

volseggs_testing::on_every_device!(
    crate::common::open => covariances_match_rotations_and_scales, invalid_covariances_are_culled,
);
