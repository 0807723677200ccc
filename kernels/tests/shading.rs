//! Shaded colours and their gradients, on every device, against the plain f64 version.

#![allow(missing_docs, clippy::unwrap_used)]

mod common;

use burn::tensor::{Device, Tensor, TensorData};
use common::{Tested, noise};
use volseggs_kernels::sh::C0;
use volseggs_kernels::shading::reference::{LitGaussian, colour};
use volseggs_kernels::shading::{GaussianShading, Light, Material, shaded};

const N: usize = 7;
const K: usize = 4;
const EYE: [f32; 3] = [0.3, -3.5, 1.2];
const LIGHTS: [Light; 2] = [Light::Head, Light::Far([1.0, -0.5, 2.0])];

/// Means, rotations, sh, normals, material.
fn inputs() -> [Vec<f32>; 5] {
    let material = Material { ambient: 0.35, specular: 0.3, exponent: 6.0 }.to_trained().to_vec();
    [noise(1, 3 * N), noise(2, 4 * N), noise(3, 3 * K * N), noise(4, 3 * N), material]
}

/// Returns the result, and the gradients of its sum weighted by `weights`; the device must be one with gradients.
fn run(inputs: &[Vec<f32>; 5], light: Light, weights: &[f32], device: &Device) -> (Vec<f32>, [Vec<f32>; 5]) {
    let rows = |v: &[f32], width: usize| {
        Tensor::<2>::from_data(TensorData::new(v.to_vec(), [v.len() / width, width]), device).require_grad()
    };
    let n = inputs[0].len() / 3;
    let (means, rotations, normals) = (rows(&inputs[0], 3), rows(&inputs[1], 4), rows(&inputs[3], 3));
    let sh = Tensor::<3>::from_data(TensorData::new(inputs[2].clone(), [n, K, 3]), device).require_grad();
    let material = Tensor::<1>::from_data(TensorData::new(inputs[4].clone(), [3]), device).require_grad();
    let shading = GaussianShading { normals: normals.clone(), material: material.clone(), light };
    let out = shaded(means.clone(), rotations.clone(), sh.clone(), &shading, EYE);
    let weights = Tensor::<3>::from_data(TensorData::new(weights.to_vec(), [n, K, 3]), device);
    let g = (out.clone() * weights).sum().backward();
    fn host<const D: usize>(t: Tensor<D>) -> Vec<f32> {
        t.into_data().try_into_vec::<f32>().unwrap()
    }
    let gradients = [
        host(means.grad(&g).unwrap()),
        host(rotations.grad(&g).unwrap()),
        host(sh.grad(&g).unwrap()),
        host(normals.grad(&g).unwrap()),
        host(material.grad(&g).unwrap()),
    ];
    (host(out.inner()), gradients)
}

/// Returns the reference's result `[N, K, 3]`.
fn reference(inputs: &[Vec<f64>; 5], light: Light) -> Vec<f64> {
    let [means, rotations, sh, normals, material] = inputs;
    let triple = |v: &[f64], i: usize| [v[i], v[i + 1], v[i + 2]];
    let mut out = sh.clone();
    for i in 0..means.len() / 3 {
        let lit = LitGaussian {
            mean: triple(means, 3 * i),
            rotation: std::array::from_fn(|c| rotations[4 * i + c]),
            sh: triple(sh, 3 * K * i),
            normal: triple(normals, 3 * i),
            material: triple(material, 0),
            eye: EYE.map(f64::from),
            light,
        };
        for (c, value) in colour(&lit).into_iter().enumerate() {
            out[3 * K * i + c] = (value - 0.5) / f64::from(C0);
        }
    }
    out
}

fn wide(inputs: &[Vec<f32>; 5]) -> [Vec<f64>; 5] {
    inputs.each_ref().map(|v| v.iter().map(|&v| f64::from(v)).collect())
}

fn colours_and_every_gradient_match_the_reference(on: Tested) {
    let device = on.device.autodiff();
    let (inputs, weights) = (inputs(), noise(5, 3 * K * N));
    for light in LIGHTS {
        let (out, gradients) = run(&inputs, light, &weights, &device);
        let mut exact = wide(&inputs);
        for (a, b) in out.iter().zip(reference(&exact, light)) {
            assert!((f64::from(*a) - b).abs() < 2e-5, "{light:?}: {a} against {b}");
        }
        let sum = |exact: &[Vec<f64>; 5]| -> f64 {
            reference(exact, light).iter().zip(&weights).map(|(v, w)| v * f64::from(*w)).sum()
        };
        for (which, found) in gradients.iter().enumerate() {
            let scale = found.iter().fold(1e-3f32, |m, g| m.max(g.abs()));
            for i in 0..found.len() {
                let at = exact[which][i];
                exact[which][i] = at + 1e-6;
                let up = sum(&exact);
                exact[which][i] = at - 1e-6;
                let slope = (up - sum(&exact)) / 2e-6;
                exact[which][i] = at;
                let off = (slope - f64::from(found[i])).abs();
                assert!(off < 1e-4 * f64::from(scale), "{light:?}, input {which}, {i}: {slope} against {}", found[i]);
            }
        }
    }
}

fn gaussians_without_a_direction_get_ambient_light_and_stay_finite(on: Tested) {
    let device = on.device.autodiff();
    let mut inputs = inputs();
    inputs[3][..3].fill(0.0); // a normal
    inputs[1][4..8].fill(0.0); // a rotation
    inputs[0][6..9].copy_from_slice(&EYE); // the eye itself
    let weights = vec![1.0; 3 * K * N];
    let (out, gradients) = run(&inputs, Light::Head, &weights, &device);
    assert!(out.iter().chain(gradients.iter().flatten()).all(|v| v.is_finite()));
    for i in 0..3 {
        for c in 0..3 {
            let want = 0.35 * (0.5 + C0 * inputs[2][3 * K * i + c]);
            let found = 0.5 + C0 * out[3 * K * i + c];
            assert!((want - found).abs() < 1e-5, "{i} {c}: {want} {found}");
        }
    }
}

fn bits_do_not_depend_on_the_number_of_threads(on: Tested) {
    let device = on.device.autodiff();
    let n = 40_000;
    let mut inputs = inputs();
    (inputs[0], inputs[1]) = (noise(1, 3 * n), noise(2, 4 * n));
    (inputs[2], inputs[3]) = (noise(3, 3 * K * n), noise(4, 3 * n));
    let weights = noise(5, 3 * K * n);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (out, gradients) = pool.install(|| run(&inputs, Light::Head, &weights, &device));
        out.into_iter().chain(gradients.into_iter().flatten()).map(f32::to_bits).collect::<Vec<_>>()
    };
    let one = on(1);
    assert!(one == on(2) && one == on(5));
}

volseggs_testing::on_every_device!(
    crate::common::open => colours_and_every_gradient_match_the_reference,
    gaussians_without_a_direction_get_ambient_light_and_stay_finite,
);
volseggs_testing::on_every_cpu_device!(
    crate::common::open => bits_do_not_depend_on_the_number_of_threads,
);

#[test]
fn a_material_survives_the_round_trip() {
    let material = Material { ambient: 0.2, specular: 0.4, exponent: 12.0 };
    let back = Material::from_trained(material.to_trained());
    for (a, b) in
        [(material.ambient, back.ambient), (material.specular, back.specular), (material.exponent, back.exponent)]
    {
        assert!((a - b).abs() < 1e-5 * a, "{a} {b}");
    }
}
