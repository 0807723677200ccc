//! The splat op against golden images and gradients in f64 (kernels/tests/golden).
#![allow(missing_docs, clippy::unwrap_used)]

mod common;

use common::{devices_and_gpu, relative_error};
use safetensors::SafeTensors;
use volseggs_kernels::Camera;
use volseggs_kernels::splat::{SplatSettings, reference};

struct Golden {
    scene: reference::Scene,
    settings: SplatSettings,
    degree: usize,
    image: Vec<f64>,
    transmittance: Vec<f64>,
    target: Vec<f64>,
    scales: Vec<f64>,
    opacities: Vec<f64>,
    /// means, quaternions, linear scales, linear opacities, sh, screen means
    gradients: [Vec<f64>; 6],
}

fn load(name: &str) -> Golden {
    let path = format!("{}/tests/golden/golden_{name}.safetensors", env!("CARGO_MANIFEST_DIR"));
    let bytes = std::fs::read(path).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let get = |key: &str| -> Vec<f64> {
        let t = file.tensor(key).unwrap();
        match t.dtype() {
            safetensors::Dtype::F64 => {
                t.data().chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect()
            }
            safetensors::Dtype::F32 => {
                t.data().chunks_exact(4).map(|b| f64::from(f32::from_le_bytes(b.try_into().unwrap()))).collect()
            }
            safetensors::Dtype::I32 => {
                t.data().chunks_exact(4).map(|b| f64::from(i32::from_le_bytes(b.try_into().unwrap()))).collect()
            }
            other => panic!("{key}: {other:?}"),
        }
    };
    let (k, view, background) = (get("K"), get("viewmat"), get("background"));
    let camera = Camera {
        width: get("width")[0] as usize,
        height: get("height")[0] as usize,
        fx: k[0] as f32,
        fy: k[4] as f32,
        cx: k[2] as f32,
        cy: k[5] as f32,
        rotation: std::array::from_fn(|r| std::array::from_fn(|c| view[4 * r + c] as f32)),
        translation: std::array::from_fn(|r| view[4 * r + 3] as f32),
    };
    let sh_stride = file.tensor("sh").unwrap().shape()[1];
    let (scales, opacities) = (get("scales"), get("opacities"));
    let scene = reference::Scene {
        means: get("means"),
        rotations: get("quats"),
        log_scales: scales.iter().map(|s| s.ln()).collect(),
        opacity_logits: opacities.iter().map(|&o| (o / (1.0 - o).max(1e-9)).ln()).collect(),
        sh: get("sh"),
        sh_stride,
    };
    let degree = if sh_stride == 16 { 3 } else { 0 };
    let background = std::array::from_fn(|c| background[c] as f32);
    Golden {
        scene,
        settings: SplatSettings { camera, background, sh_degree: degree },
        degree,
        image: get("image"),
        transmittance: get("final_T"),
        target: get("target"),
        scales,
        opacities,
        gradients: [
            get("grad_means"),
            get("grad_quats"),
            get("grad_scales"),
            get("grad_opacities"),
            get("grad_sh"),
            get("grad_means2d"),
        ],
    }
}

fn psnr(a: impl Iterator<Item = f64>, b: &[f64]) -> f64 {
    let mse = a.zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f64>() / b.len() as f64;
    -10.0 * mse.max(1e-30).log10()
}

#[test]
fn the_reference_reproduces_the_golden_images() {
    for name in ["sh0", "sh3", "edge"] {
        let g = load(name);
        assert_eq!(g.degree, g.settings.sh_degree);
        let image = reference::render(&g.scene, &g.settings);
        let rgb = image.chunks_exact(4).flat_map(|p| p[..3].to_vec());
        let db = psnr(rgb, &g.image);
        assert!(db > 120.0, "{name}: {db:.1} dB");
    }
}

#[test]
fn image_and_alpha_match_on_every_device() {
    for name in ["sh0", "sh3", "edge"] {
        let g = load(name);
        for (device_name, device) in devices_and_gpu() {
            let out = volseggs_kernels::splat::splat(common::inputs(&g.scene, &device), g.settings);
            let image = common::to_vec(out.image);
            let db = psnr(
                image.chunks_exact(4).flat_map(|p| p[..3].iter().map(|&v| f64::from(v)).collect::<Vec<_>>()),
                &g.image,
            );
            let alpha: Vec<f64> = g.transmittance.iter().map(|t| 1.0 - t).collect();
            let alpha_db = psnr(image.chunks_exact(4).map(|p| f64::from(p[3])), &alpha);
            println!("{name} on {device_name}: rgb {db:.1} dB, alpha {alpha_db:.1} dB");
            assert!(db > 95.0 && alpha_db > 95.0, "{name} on {device_name}: rgb {db:.1} dB, alpha {alpha_db:.1} dB");
        }
    }
}

#[test]
fn gradients_match_on_every_device() {
    for name in ["sh0", "sh3", "edge"] {
        let g = load(name);
        let (h, w) = (g.settings.camera.height, g.settings.camera.width);
        // loss = mean (C - target)^2 over H*W*3: its gradient, from the golden image, and none for alpha
        let weights: Vec<f32> = g
            .image
            .chunks_exact(3)
            .zip(g.target.chunks_exact(3))
            .flat_map(|(c, t)| {
                let s = 2.0 / (h * w * 3) as f64;
                [s * (c[0] - t[0]), s * (c[1] - t[1]), s * (c[2] - t[2]), 0.0].map(|v| v as f32)
            })
            .collect();
        // the golden gradients are for linear scales and opacities
        let mut expected = g.gradients.clone();
        for (v, s) in expected[2].iter_mut().zip(&g.scales) {
            *v *= s;
        }
        for (v, o) in expected[3].iter_mut().zip(&g.opacities) {
            *v *= o * (1.0 - o);
        }
        for (device_name, device) in devices_and_gpu() {
            let (_, ours) = common::gradients(&g.scene, g.settings, &weights, &device);
            let names = ["means", "rotations", "log_scales", "opacity_logits", "sh", "screen"];
            for ((what, ours), expected) in names.iter().zip(&ours).zip(&expected) {
                let error = relative_error(ours, expected);
                println!("{name} on {device_name}: {what} {error:.2e}");
                assert!(ours.iter().all(|v| v.is_finite()));
                assert!(error < 2e-3, "{name} on {device_name}: {what} off by {error:.2e} of the norm");
            }
        }
    }
}
