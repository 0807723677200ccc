//! Shared by the tests: devices, scenes, golden files, comparisons.
#![allow(dead_code, deprecated, missing_docs, clippy::unwrap_used)]

use burn::tensor::{Device, Tensor, TensorData};
use volseggs_kernels::Camera;
use volseggs_kernels::splat::{SplatInputs, SplatSettings, reference::Scene};

/// Every device compiled in, with its name.
pub fn devices() -> Vec<(&'static str, Device)> {
    vec![
        #[cfg(feature = "flex")]
        ("flex", Device::flex()),
        #[cfg(feature = "ndarray")]
        ("ndarray", Device::ndarray()),
        #[cfg(feature = "tch")]
        ("tch", Device::libtorch()),
    ]
}

/// The GPU that wgpu would choose, software ones included. Without one a line says so and tests skip, unless
/// `VOLSEGGS_REQUIRE_GPU` is set: then they fail.
#[cfg(feature = "wgpu")]
pub fn gpu() -> Option<Device> {
    static GPU: std::sync::LazyLock<Result<Device, String>> = std::sync::LazyLock::new(|| {
        let device = Device::wgpu_options().init().map_err(|e| e.to_string());
        if let Err(error) = &device {
            use std::io::Write;
            // past the capture of tests, so that it is seen
            let _ = writeln!(std::io::stderr(), "skipped: the GPU tests, as there is no adapter ({error})");
        }
        device
    });
    if let Err(error) = &*GPU {
        assert!(std::env::var_os("VOLSEGGS_REQUIRE_GPU").is_none(), "no GPU adapter: {error}");
    }
    GPU.clone().ok()
}

/// [`devices`] and the GPU, for tests that do not ask for the same bits.
pub fn devices_and_gpu() -> Vec<(&'static str, Device)> {
    #[allow(unused_mut)]
    let mut all = devices();
    #[cfg(feature = "wgpu")]
    all.extend(gpu().map(|gpu| ("wgpu", gpu)));
    all
}

/// A small pinhole camera at distance 4 on the -z axis, looking at the origin.
pub fn camera(width: usize, height: usize) -> Camera {
    let f = 0.5 * width.max(height) as f32 / (15f32).to_radians().tan();
    Camera {
        width,
        height,
        fx: f,
        fy: f * 1.05,
        cx: 0.5 * width as f32 + 0.3,
        cy: 0.5 * height as f32 - 0.2,
        rotation: [[0.96, 0.0, -0.28], [0.0, 1.0, 0.0], [0.28, 0.0, 0.96]],
        translation: [0.05, -0.1, 4.0],
    }
}

/// A deterministic stream of numbers in [0, 1).
pub struct Numbers(pub u64);

impl Numbers {
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.next()).sum::<f64>() - 6.0
    }
}

/// `n` random Gaussians in a ball of radius about 1.
pub fn random_scene(n: usize, degree: usize, seed: u64) -> Scene {
    let mut r = Numbers(seed);
    let stride = (degree + 1) * (degree + 1);
    Scene {
        means: (0..3 * n).map(|_| 0.4 * r.normal()).collect(),
        rotations: (0..4 * n).map(|_| r.normal()).collect(),
        log_scales: (0..3 * n).map(|_| -2.6 + 0.5 * r.normal()).collect(),
        opacity_logits: (0..n).map(|_| 1.2 * r.normal()).collect(),
        sh: (0..3 * n * stride).map(|_| 0.4 * r.normal()).collect(),
        sh_stride: stride,
    }
}

pub fn settings(camera: Camera, sh_degree: usize) -> SplatSettings {
    SplatSettings { camera, background: [0.1, 0.2, 0.3], sh_degree }
}

fn f32s(v: &[f64]) -> Vec<f32> {
    v.iter().map(|&x| x as f32).collect()
}

/// The scene as tensors on `device`; all of them ask for gradients if the device is an autodiff one.
pub fn inputs(scene: &Scene, device: &Device) -> SplatInputs {
    let n = scene.opacity_logits.len();
    let k = scene.sh_stride;
    SplatInputs {
        means: Tensor::from_data(TensorData::new(f32s(&scene.means), [n, 3]), device),
        rotations: Tensor::from_data(TensorData::new(f32s(&scene.rotations), [n, 4]), device),
        log_scales: Tensor::from_data(TensorData::new(f32s(&scene.log_scales), [n, 3]), device),
        opacity_logits: Tensor::from_data(TensorData::new(f32s(&scene.opacity_logits), [n]), device),
        sh: Tensor::from_data(TensorData::new(f32s(&scene.sh), [n, k, 3]), device),
        screen_offsets: Some(Tensor::zeros([n, 2], device)),
    }
}

pub fn require_grad(i: SplatInputs) -> SplatInputs {
    SplatInputs {
        means: i.means.require_grad(),
        rotations: i.rotations.require_grad(),
        log_scales: i.log_scales.require_grad(),
        opacity_logits: i.opacity_logits.require_grad(),
        sh: i.sh.require_grad(),
        screen_offsets: i.screen_offsets.map(Tensor::require_grad),
    }
}

pub fn to_vec<const D: usize>(t: Tensor<D>) -> Vec<f32> {
    t.into_data().try_into_vec::<f32>().unwrap()
}

/// Gradients in the order means, rotations, log_scales, opacity_logits, sh, screen_offsets of
/// `sum(image * weights)`, and the image.
pub fn gradients(
    scene: &Scene,
    settings: SplatSettings,
    weights: &[f32],
    device: &Device,
) -> (Vec<f32>, [Vec<f32>; 6]) {
    let device = device.clone().autodiff();
    let i = require_grad(inputs(scene, &device));
    let out = volseggs_kernels::splat::splat(i.clone(), settings);
    let (h, w) = (settings.camera.height, settings.camera.width);
    let weights = Tensor::<3>::from_data(TensorData::new(weights.to_vec(), [h, w, 4]), &device);
    let g = (out.image.clone() * weights).sum().backward();
    let image = to_vec(out.image.inner());
    (
        image,
        [
            to_vec(i.means.grad(&g).unwrap()),
            to_vec(i.rotations.grad(&g).unwrap()),
            to_vec(i.log_scales.grad(&g).unwrap()),
            to_vec(i.opacity_logits.grad(&g).unwrap()),
            to_vec(i.sh.grad(&g).unwrap()),
            to_vec(i.screen_offsets.unwrap().grad(&g).unwrap()),
        ],
    )
}

/// `|a - b| / |b|` over all entries.
pub fn relative_error(a: &[f32], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let d: f64 = a.iter().zip(b).map(|(&x, &y)| (f64::from(x) - y).powi(2)).sum();
    let n: f64 = b.iter().map(|y| y * y).sum();
    (d / n.max(1e-300)).sqrt()
}
