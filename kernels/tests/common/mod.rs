//! Code shared by the tests: devices, scenes, golden files, comparisons.
#![allow(dead_code, deprecated, missing_docs, clippy::unwrap_used)]

use burn::tensor::{Device, Tensor, TensorData};
use volseggs_kernels::PinholeCamera;
use volseggs_kernels::sh::Bands;
use volseggs_kernels::splat::{CovarianceInputs, Rendering, SplatInputs, SplatSettings, reference::ReferenceScene};
use volseggs_kernels::splat::{splat, splat_covariances};
use volseggs_testing::skip_device;

/// A device that a test runs on.
pub struct Tested {
    pub name: &'static str,
    pub device: Device,
    /// Whether its kernels are those of `cube`, not those of `cpu`.
    pub gpu: bool,
}

impl Tested {
    /// Returns the tolerance for this device: `cpu`, or `gpu` on a GPU.
    pub fn within(&self, cpu: f64, gpu: f64) -> f64 {
        if self.gpu { gpu } else { cpu }
    }

    /// Returns the results of `f` on the device with gradients; on the CPU, asserts that the bits are those of the
    /// first device.
    pub fn results(&self, f: impl Fn(&Device) -> Vec<Vec<f32>>) -> Vec<Vec<f32>> {
        let ours = f(&self.device.clone().autodiff());
        assert!(self.gpu || ours == f(&cpu().autodiff()), "{} differs from the first device in its bits", self.name);
        ours
    }
}

/// Opens a device that is compiled in, for `volseggs_testing::on_every_device`; reports it and returns `None` if it
/// does not start.
pub fn open(name: &'static str) -> Option<Tested> {
    let (device, gpu): (Result<Device, String>, bool) = match name {
        #[cfg(feature = "flex")]
        "flex" => (Ok(Device::flex()), false),
        #[cfg(feature = "ndarray")]
        "ndarray" => (Ok(Device::ndarray()), false),
        #[cfg(feature = "tch")]
        "tch" => (Ok(Device::libtorch()), false),
        #[cfg(feature = "wgpu")]
        "wgpu" => (wgpu(), true),
        #[cfg(feature = "cuda")]
        "cuda" => (cuda(), true),
        other => panic!("device {other} is not in this build"),
    };
    device.map(|device| Tested { name, device, gpu }).map_err(|why| skip_device(name, &why)).ok()
}

/// Opens the GPU that wgpu would choose, software adapters included.
#[cfg(feature = "wgpu")]
fn wgpu() -> Result<Device, String> {
    static GPU: std::sync::LazyLock<Result<Device, String>> =
        std::sync::LazyLock::new(|| Device::wgpu_options().init().map_err(|e| e.to_string()));
    GPU.clone()
}

/// Opens the first CUDA device. The runtime panics if there is none.
#[cfg(feature = "cuda")]
fn cuda() -> Result<Device, String> {
    static GPU: std::sync::LazyLock<Result<Device, String>> = std::sync::LazyLock::new(|| {
        let start = || {
            let device = Device::cuda(0);
            Tensor::<1>::zeros([1], &device).into_data();
            device
        };
        std::panic::catch_unwind(start).map_err(|_| "no CUDA device or driver".to_owned())
    });
    GPU.clone()
}

/// Returns the first CPU device, for tests on a single device and as the reference for the others.
pub fn cpu() -> Device {
    let first = if cfg!(feature = "flex") {
        "flex"
    } else if cfg!(feature = "ndarray") {
        "ndarray"
    } else {
        "tch"
    };
    open(first).unwrap().device
}

/// Returns numbers in [-1, 1].
pub fn noise(seed: u64, len: usize) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    };
    (0..len).map(|_| next()).collect()
}

/// A small pinhole camera at distance 4 on the -z axis, looking at the origin.
pub fn camera(width: usize, height: usize) -> PinholeCamera {
    let f = 0.5 * width.max(height) as f32 / (15f32).to_radians().tan();
    PinholeCamera {
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

/// Every number of spherical-harmonics coefficients: of all bands, and of the even ones.
pub const COEFFICIENTS: [usize; 6] = [1, 4, 9, 16, 6, 15];

/// Returns the highest degree of that many coefficients.
pub fn highest_degree(coefficients: usize) -> usize {
    Bands::from_count(coefficients).map(|(_, degree)| degree).unwrap()
}

/// Returns `n` random Gaussians in a ball of radius about 1, with colours of `degree`.
pub fn random_scene(n: usize, degree: usize, seed: u64) -> ReferenceScene {
    random_scene_of(n, (degree + 1) * (degree + 1), seed)
}

/// As [`random_scene`], with one of [`COEFFICIENTS`].
pub fn random_scene_of(n: usize, stride: usize, seed: u64) -> ReferenceScene {
    let mut r = Numbers(seed);
    ReferenceScene {
        means: (0..3 * n).map(|_| 0.4 * r.normal()).collect(),
        rotations: (0..4 * n).map(|_| r.normal()).collect(),
        log_scales: (0..3 * n).map(|_| -2.6 + 0.5 * r.normal()).collect(),
        covariances: vec![],
        opacity_logits: (0..n).map(|_| 1.2 * r.normal()).collect(),
        sh: (0..3 * n * stride).map(|_| 0.4 * r.normal()).collect(),
        sh_stride: stride,
        screen_offsets: vec![0.0; 2 * n],
    }
}

/// A field of a scene, or of its gradient.
pub type Field = fn(&mut ReferenceScene) -> &mut Vec<f64>;

/// The fields that have a gradient, in the order of [`gradients`].
pub const FIELDS: [(&str, Field); 6] = [
    ("means", |s| &mut s.means),
    ("rotations", |s| &mut s.rotations),
    ("log_scales", |s| &mut s.log_scales),
    ("opacity_logits", |s| &mut s.opacity_logits),
    ("sh", |s| &mut s.sh),
    ("screen_offsets", |s| &mut s.screen_offsets),
];

/// As [`FIELDS`], for a scene with covariances.
pub const COVARIANCE_FIELDS: [(&str, Field); 5] = [
    ("means", |s| &mut s.means),
    ("covariances", |s| &mut s.covariances),
    ("opacity_logits", |s| &mut s.opacity_logits),
    ("sh", |s| &mut s.sh),
    ("screen_offsets", |s| &mut s.screen_offsets),
];

/// Returns the fields of this scene that have a gradient.
pub fn fields(scene: &ReferenceScene) -> &'static [(&'static str, Field)] {
    if scene.covariances.is_empty() { &FIELDS } else { &COVARIANCE_FIELDS }
}

/// Returns the same scene with covariances `R S S^T R^T` in place of rotations and scales, which become NaN.
pub fn by_covariances(mut scene: ReferenceScene) -> ReferenceScene {
    let rows = scene.rotations.chunks_exact(4).zip(scene.log_scales.chunks_exact(3));
    scene.covariances = rows.flat_map(|(q, s)| covariance([q[0], q[1], q[2], q[3]], [s[0], s[1], s[2]])).collect();
    scene.rotations.fill(f64::NAN);
    scene.log_scales.fill(f64::NAN);
    scene
}

/// Returns the entries xx, xy, xz, yy, yz, zz of `R S S^T R^T`. Columns of R: the axes rotated by the quaternion,
/// `v + 2 u x (u x v + w v)`.
pub fn covariance(quaternion: [f64; 4], log_scales: [f64; 3]) -> [f64; 6] {
    let length = quaternion.iter().map(|v| v * v).sum::<f64>().sqrt();
    let [w, u @ ..] = quaternion.map(|v| v / length);
    let cross = |a: [f64; 3], b: [f64; 3]| -> [f64; 3] {
        std::array::from_fn(|k| a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3])
    };
    let columns: [[f64; 3]; 3] = std::array::from_fn(|k| {
        let axis = std::array::from_fn(|r| f64::from(u8::from(r == k)));
        let inner = cross(u, axis);
        let outer = cross(u, std::array::from_fn(|r| inner[r] + w * axis[r]));
        std::array::from_fn(|r| (axis[r] + 2.0 * outer[r]) * log_scales[k].exp())
    });
    let entry = |a: usize, b: usize| columns.iter().map(|c| c[a] * c[b]).sum();
    [entry(0, 0), entry(0, 1), entry(0, 2), entry(1, 1), entry(1, 2), entry(2, 2)]
}

/// Converts gradients in the order of [`COVARIANCE_FIELDS`] to those with respect to the rotations and scales of
/// `scene`, in the order of [`FIELDS`]: the chain rule, with difference quotients of [`covariance`].
pub fn to_factors(scene: &ReferenceScene, gradients: &[Vec<f64>]) -> Vec<Vec<f64>> {
    const STEP: f64 = 1e-3;
    let [means, by_entries, opacity_logits, sh, offsets] = gradients else { panic!("five gradients") };
    let (mut rotations, mut log_scales) = (Vec::new(), Vec::new());
    for (i, by) in by_entries.chunks_exact(6).enumerate() {
        let factors: [f64; 7] =
            std::array::from_fn(|k| if k < 4 { scene.rotations[4 * i + k] } else { scene.log_scales[3 * i + k - 4] });
        // the product of the gradient with the entries, after one of the factors is moved
        let moved = |k: usize, steps: f64| -> f64 {
            let mut f = factors;
            f[k] += steps * STEP;
            covariance([f[0], f[1], f[2], f[3]], [f[4], f[5], f[6]]).iter().zip(by).map(|(v, g)| v * g).sum()
        };
        for k in 0..7 {
            let (near, far) = (moved(k, 1.0) - moved(k, -1.0), moved(k, 2.0) - moved(k, -2.0));
            let out = if k < 4 { &mut rotations } else { &mut log_scales };
            out.push((8.0 * near - far) / (12.0 * STEP));
        }
    }
    vec![means.clone(), rotations, log_scales, opacity_logits.clone(), sh.clone(), offsets.clone()]
}

/// Rounds the scene to f32, as the kernels receive it, so that it is the same for them and for the reference.
pub fn rounded(mut scene: ReferenceScene) -> ReferenceScene {
    for (_, field) in fields(&scene) {
        field(&mut scene).iter_mut().for_each(|v| *v = f64::from(*v as f32));
    }
    scene
}

pub fn settings(camera: PinholeCamera, sh_degree: usize) -> SplatSettings {
    Rendering { background: [0.1, 0.2, 0.3], sh_degree, ..Rendering::default() }.seen_by(camera)
}

fn f32s(v: &[f64]) -> Vec<f32> {
    v.iter().map(|&x| x as f32).collect()
}

/// Returns the scene as tensors on `device`; [`require_grad`] makes them record gradients.
pub fn inputs(scene: &ReferenceScene, device: &Device) -> SplatInputs {
    let n = scene.opacity_logits.len();
    let k = scene.sh_stride;
    let rows = |values: &[f64], width| Tensor::from_data(TensorData::new(f32s(values), [n, width]), device);
    let opacity_logits = Tensor::from_data(TensorData::new(f32s(&scene.opacity_logits), [n]), device);
    let sh = Tensor::from_data(TensorData::new(f32s(&scene.sh), [n, k, 3]), device);
    let (rotations, log_scales) = (rows(&scene.rotations, 4), rows(&scene.log_scales, 3));
    let screen_offsets = Some(rows(&scene.screen_offsets, 2));
    SplatInputs { screen_offsets, ..SplatInputs::new(rows(&scene.means, 3), rotations, log_scales, opacity_logits, sh) }
}

/// As [`inputs`], for a scene with covariances.
pub fn covariance_inputs(scene: &ReferenceScene, device: &Device) -> CovarianceInputs {
    let n = scene.opacity_logits.len();
    let SplatInputs { means, opacity_logits, sh, screen_offsets, .. } = inputs(scene, device);
    let covariances = Tensor::from_data(TensorData::new(f32s(&scene.covariances), [n, 6]), device);
    CovarianceInputs { means, covariances, opacity_logits, sh, screen_offsets }
}

/// Renders the image `[H, W, 4]` of the scene with the op on `device`.
pub fn image(scene: &ReferenceScene, settings: SplatSettings, device: &Device) -> Vec<f32> {
    let out = if scene.covariances.is_empty() {
        splat(inputs(scene, device), settings)
    } else {
        splat_covariances(covariance_inputs(scene, device), settings)
    };
    to_vec(out.image)
}

pub fn require_grad(i: SplatInputs) -> SplatInputs {
    SplatInputs {
        means: i.means.require_grad(),
        rotations: i.rotations.require_grad(),
        log_scales: i.log_scales.require_grad(),
        opacity_logits: i.opacity_logits.require_grad(),
        sh: i.sh.require_grad(),
        screen_offsets: i.screen_offsets.map(Tensor::require_grad),
        ..i
    }
}

pub fn to_vec<const D: usize>(t: Tensor<D>) -> Vec<f32> {
    t.into_data().try_into_vec::<f32>().unwrap()
}

/// Returns the image, and the gradients of `sum(image * weights)` in the order of [`fields`].
pub fn gradients(
    scene: &ReferenceScene,
    settings: SplatSettings,
    weights: &[f32],
    device: &Device,
) -> (Vec<f32>, Vec<Vec<f32>>) {
    let device = device.clone().autodiff();
    let (h, w) = (settings.camera.height, settings.camera.width);
    let weights = Tensor::<3>::from_data(TensorData::new(weights.to_vec(), [h, w, 4]), &device);
    if scene.covariances.is_empty() {
        let i = require_grad(inputs(scene, &device));
        let image = splat(i.clone(), settings).image;
        let g = (image.clone() * weights).sum().backward();
        let gradients = vec![
            to_vec(i.means.grad(&g).unwrap()),
            to_vec(i.rotations.grad(&g).unwrap()),
            to_vec(i.log_scales.grad(&g).unwrap()),
            to_vec(i.opacity_logits.grad(&g).unwrap()),
            to_vec(i.sh.grad(&g).unwrap()),
            to_vec(i.screen_offsets.unwrap().grad(&g).unwrap()),
        ];
        (to_vec(image.inner()), gradients)
    } else {
        let i = covariance_inputs(scene, &device);
        let i = CovarianceInputs {
            means: i.means.require_grad(),
            covariances: i.covariances.require_grad(),
            opacity_logits: i.opacity_logits.require_grad(),
            sh: i.sh.require_grad(),
            screen_offsets: i.screen_offsets.map(Tensor::require_grad),
        };
        let image = splat_covariances(i.clone(), settings).image;
        let g = (image.clone() * weights).sum().backward();
        let gradients = vec![
            to_vec(i.means.grad(&g).unwrap()),
            to_vec(i.covariances.grad(&g).unwrap()),
            to_vec(i.opacity_logits.grad(&g).unwrap()),
            to_vec(i.sh.grad(&g).unwrap()),
            to_vec(i.screen_offsets.unwrap().grad(&g).unwrap()),
        ];
        (to_vec(image.inner()), gradients)
    }
}

/// `|a - b| / |b|` over all entries.
pub fn relative_error(a: &[f32], b: &[f64]) -> f64 {
    distance(&a.iter().map(|&v| f64::from(v)).collect::<Vec<_>>(), b)
}

/// As [`relative_error`], for f64 values.
pub fn distance(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let d: f64 = a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum();
    let n: f64 = b.iter().map(|y| y * y).sum();
    (d / n.max(1e-300)).sqrt()
}
