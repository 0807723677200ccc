//! Code shared by the benchmarks: a translucent ball of Gaussians, its camera, clocks and statistics. This module times
//! nothing on its own and accesses no files.
#![allow(dead_code)]

use burn::backend::tensor::FloatTensor;
use burn::backend::{Dispatch, TensorMetadata};
use burn::tensor::{Device, Tensor, TensorData};
use std::time::Instant;
use volseggs_kernels::activation::logit_f64;
use volseggs_kernels::splat::{
    Rendering, SplatBackwardOps, SplatForward, SplatInputs, SplatOps, SplatSettings, SplatTensors,
};
use volseggs_kernels::{PinholeCamera, sh};

/// Spherical-harmonics coefficients per Gaussian (degree 3).
pub const SH_COEFFICIENTS: usize = 16;

/// A deterministic stream of numbers (splitmix64).
pub struct Numbers(pub u64);

impl Numbers {
    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut x = self.0;
        x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Standard normal.
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    /// Returns `n` values drawn with `f`.
    pub fn take(&mut self, n: usize, f: impl Fn(&mut Self) -> f64) -> Vec<f32> {
        (0..n).map(|_| f(self) as f32).collect()
    }
}

/// Gaussians on the host, row-major.
pub struct Scene {
    /// `[N, 3]`
    pub means: Vec<f32>,
    /// `[N, 4]`
    pub rotations: Vec<f32>,
    /// `[N, 3]`
    pub log_scales: Vec<f32>,
    /// `[N]`
    pub opacity_logits: Vec<f32>,
    /// `[N, 16, 3]`
    pub sh: Vec<f32>,
}

/// Returns `n` Gaussians, uniform in the unit ball: log-normal scales around 0.7 of the mean spacing, opacities in
/// [0.05, 0.6], colours of degree 3.
pub fn scene(n: usize, seed: u64) -> Scene {
    let mut r = Numbers(seed);
    let spacing = (4.0 / 3.0 * std::f64::consts::PI / n as f64).cbrt();
    let mut means = Vec::with_capacity(3 * n);
    for _ in 0..n {
        let d: [f64; 3] = std::array::from_fn(|_| r.normal());
        let length = d.iter().map(|v| v * v).sum::<f64>().sqrt();
        let radius = r.uniform().cbrt();
        means.extend(d.map(|v| (v / length * radius) as f32));
    }
    let mut sh = Vec::with_capacity(3 * SH_COEFFICIENTS * n);
    for _ in 0..n {
        sh.extend(r.take(3, |r| (0.05 + 0.9 * r.uniform() - 0.5) / f64::from(sh::C0)));
        sh.extend(r.take(3 * (SH_COEFFICIENTS - 1), |r| 0.08 * r.normal()));
    }
    Scene {
        means,
        rotations: r.take(4 * n, Numbers::normal),
        log_scales: r.take(3 * n, |r| (0.7 * spacing).ln() + 0.35 * r.normal()),
        opacity_logits: r.take(n, |r| logit_f64(0.05 + 0.55 * r.uniform())),
        sh,
    }
}

/// Returns the camera of a square image of `size` pixels per side, 30 degrees wide, at distance 4 from the origin.
pub fn camera(size: usize) -> PinholeCamera {
    let (a, b) = (0.4f64, 0.7f64);
    let f = [-a.cos() * b.cos(), -a.cos() * b.sin(), -a.sin()];
    let r = [f[1], -f[0], 0.0].map(|v| v / f[0].hypot(f[1]));
    let d = [f[1] * r[2] - f[2] * r[1], f[2] * r[0] - f[0] * r[2], f[0] * r[1] - f[1] * r[0]];
    let focal = 0.5 * size as f64 / 15f64.to_radians().tan();
    PinholeCamera {
        width: size,
        height: size,
        fx: focal as f32,
        fy: focal as f32,
        cx: 0.5 * size as f32,
        cy: 0.5 * size as f32,
        rotation: [r, d, f].map(|row| row.map(|v| v as f32)),
        translation: [0.0, 0.0, 4.0],
    }
}

/// A scene on a device, ready to be splatted without automatic differentiation.
pub struct Splatter {
    inputs: SplatInputs,
    /// Camera, background, degree.
    pub settings: SplatSettings,
}

impl Splatter {
    /// Uploads `scene` to `device`, with a black background and SH degree 3.
    pub fn new(scene: &Scene, camera: PinholeCamera, device: &Device) -> Self {
        let n = scene.opacity_logits.len();
        let rows = |v: &[f32], d: usize| Tensor::<2>::from_data(TensorData::new(v.to_vec(), [n, d]), device);
        let (means, rotations, log_scales) =
            (rows(&scene.means, 3), rows(&scene.rotations, 4), rows(&scene.log_scales, 3));
        let opacity_logits = Tensor::from_data(TensorData::new(scene.opacity_logits.clone(), [n]), device);
        let sh = Tensor::from_data(TensorData::new(scene.sh.clone(), [n, SH_COEFFICIENTS, 3]), device);
        let screen_offsets = Some(Tensor::zeros([n, 2], device));
        let plain = SplatInputs::new(means, rotations, log_scales, opacity_logits, sh);
        let inputs = SplatInputs { screen_offsets, ..plain };
        Self { inputs, settings: Rendering { sh_degree: 3, ..Rendering::default() }.seen_by(camera) }
    }

    /// Runs the forward pass alone.
    pub fn forward(&self) -> SplatForward<Dispatch> {
        Dispatch::splat_forward(self.inputs.clone().into_tensors(), self.settings, true)
    }

    /// Runs the backward pass alone, for a gradient of the image `[H, W, 4]`.
    pub fn backward(&self, forward: &SplatForward<Dispatch>, grad: &Tensor<3>) -> SplatTensors<Dispatch> {
        let (grad, saved) = (grad.clone().into_dispatch(), forward.saved.clone());
        Dispatch::splat_backward(self.inputs.clone().into_tensors(), grad, self.settings, saved)
    }
}

/// Returns the image `[H, W, 4]` of a forward pass, on the host.
pub fn image(forward: &SplatForward<Dispatch>) -> Vec<f32> {
    host(forward.image.clone())
}

/// Returns the values of a dispatched tensor.
pub fn host(tensor: FloatTensor<Dispatch>) -> Vec<f32> {
    let len = tensor.shape().num_elements();
    let data = match tensor.shape().num_dims() {
        1 => Tensor::<1>::from_dispatch(tensor).into_data(),
        2 => Tensor::<2>::from_dispatch(tensor).into_data(),
        _ => Tensor::<3>::from_dispatch(tensor).into_data(),
    };
    let values = data.try_into_vec::<f32>().unwrap_or_default();
    assert_eq!(values.len(), len, "every device computes in f32");
    values
}

/// Gradient of the mean squared error of the colours against a random target; zero for alpha.
pub fn l2_gradient(image: &[f32], seed: u64) -> Vec<f32> {
    let mut r = Numbers(seed);
    let scale = 2.0 / (0.75 * image.len() as f32);
    let mut grad = vec![0.0; image.len()];
    for (g, p) in grad.chunks_exact_mut(4).zip(image.chunks_exact(4)) {
        for c in 0..3 {
            g[c] = scale * (p[c] - r.uniform() as f32);
        }
    }
    grad
}

/// Durations of several runs in milliseconds, ascending.
#[derive(Clone, Debug, Default)]
pub struct Samples(Vec<f64>);

impl Samples {
    /// Sorts the runs.
    pub fn new(mut milliseconds: Vec<f64>) -> Self {
        milliseconds.sort_by(f64::total_cmp);
        Self(milliseconds)
    }

    /// Returns the shortest duration; NaN without runs.
    pub fn min(&self) -> f64 {
        self.0.first().copied().unwrap_or(f64::NAN)
    }

    /// Returns the median duration; NaN without runs.
    pub fn median(&self) -> f64 {
        self.0.get(self.0.len() / 2).copied().unwrap_or(f64::NAN)
    }
}

/// Runs `f` once unmeasured and then `repeats` times; returns wall times, and CPU times of the whole process.
pub fn measure<T>(repeats: usize, mut f: impl FnMut() -> T) -> (Samples, Samples) {
    std::hint::black_box(f());
    let (mut wall, mut cpu) = (Vec::new(), Vec::new());
    for _ in 0..repeats {
        let (start, busy) = (Instant::now(), process_cpu_ms());
        let out = f();
        cpu.push(process_cpu_ms() - busy);
        wall.push(start.elapsed().as_secs_f64() * 1e3);
        std::hint::black_box(out);
    }
    (Samples::new(wall), Samples::new(cpu))
}

/// CPU time used by all threads of this process, in milliseconds; NaN on unsupported systems.
#[cfg(all(target_os = "linux", target_pointer_width = "64"))]
pub fn process_cpu_ms() -> f64 {
    #[repr(C)]
    struct Timespec {
        seconds: i64,
        nanoseconds: i64,
    }
    unsafe extern "C" {
        fn clock_gettime(clock: i32, time: *mut Timespec) -> i32;
    }
    const CLOCK_PROCESS_CPUTIME_ID: i32 = 2;
    let mut time = Timespec { seconds: 0, nanoseconds: 0 };
    // SAFETY: the C library's function, with its layout on 64-bit Linux; it writes only `time`.
    let status = unsafe { clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &raw mut time) };
    if status == 0 { time.seconds as f64 * 1e3 + time.nanoseconds as f64 * 1e-6 } else { f64::NAN }
}

/// CPU time used by all threads of this process, in milliseconds; NaN on unsupported systems.
#[cfg(not(all(target_os = "linux", target_pointer_width = "64")))]
pub fn process_cpu_ms() -> f64 {
    f64::NAN
}

/// Parses the command line: bare words, the number after `--repeats`, and the name after `--device`, which is `flex`
/// if not given. Cargo's own `--bench` is ignored.
pub fn arguments(default_repeats: usize) -> (Vec<String>, usize, String) {
    let (mut words, mut repeats, mut device) = (Vec::new(), default_repeats, "flex".to_owned());
    let mut rest = std::env::args().skip(1);
    while let Some(word) = rest.next() {
        match word.as_str() {
            "--bench" => {}
            "--repeats" => repeats = rest.next().and_then(|n| n.parse().ok()).unwrap_or(default_repeats).max(1),
            "--device" => device = rest.next().expect("a device after --device"),
            _ => words.push(word),
        }
    }
    (words, repeats, device)
}
