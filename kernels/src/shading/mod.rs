//! Two-sided Blinn-Phong shading of Gaussians by one white light, as `volseggs` shades its images of volumes. It
//! computes the colours that [`crate::splat::splat`] draws, with their gradients: on the CPU by one kernel in [`cpu`],
//! on other devices by tensor operations.
//!
//! A Gaussian has a base colour `b = 0.5 + C0 sh_0`, its appearance under full light, and a normal `n` in its own
//! frame, which its rotation turns. With the direction `l` to the light and `h` halfway between that and the direction
//! to the eye,
//!
//! ```text
//! colour = b (ambient + (1 - ambient) |n.l|) + specular |n.h|^exponent
//! ```
//!
//! and the spherical-harmonics coefficients beyond the first add the remainder. With a headlight, `l` and `h` are the
//! direction to the eye. Diffuse light has no factor other than `1 - ambient`: base colours absorb it.

pub mod cpu;
mod ops;
pub mod reference;

pub use ops::{ShadeBackwardOps, ShadeOps, ShadeTensors};

use crate::sh::C0;
use burn::tensor::activation::sigmoid;
use burn::tensor::{Device, Tensor, TensorData};

/// Number of trained parameters of a material.
pub const MATERIAL: usize = 3;
/// Lower bound for squared lengths, so that a Gaussian without a direction is lit by ambient light alone.
const MIN_SQUARE: f32 = 1e-12;
/// Lower bound for the cosine, so that its logarithm is finite.
const GRAZING: f32 = 1e-6;

/// How a material responds to white light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Fraction of the base colour that is visible without light, in (0, 1).
    pub ambient: f32,
    /// Strength of the white highlight, above 0.
    pub specular: f32,
    /// Exponent of the highlight, above 0; the larger, the smaller the highlight.
    pub exponent: f32,
}

impl Material {
    /// Returns the trained form `[3]`: the logit of `ambient`, the natural logarithms of `specular` and `exponent`.
    pub fn to_trained(self) -> [f32; MATERIAL] {
        [crate::activation::logit(self.ambient), self.specular.ln(), self.exponent.ln()]
    }

    /// Inverts [`Material::to_trained`].
    pub fn from_trained([ambient, specular, exponent]: [f32; MATERIAL]) -> Self {
        Self { ambient: crate::activation::sigmoid(ambient), specular: specular.exp(), exponent: exponent.exp() }
    }
}

/// Where the light is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Light {
    /// At the eye.
    #[default]
    Head,
    /// Far away in this direction, in world axes, of any length but 0.
    Far([f32; 3]),
}

/// Shading parameters of a set of Gaussians.
#[derive(Clone, Debug)]
pub struct GaussianShading {
    /// Normals in the Gaussians' own frames `[N, 3]`; their lengths do not matter.
    pub normals: Tensor<2>,
    /// The material of all Gaussians, as [`Material::to_trained`] `[3]`.
    pub material: Tensor<1>,
    /// The light.
    pub light: Light,
}

/// Returns spherical-harmonics coefficients `[N, K, 3]` whose first give the shaded colours of Gaussians at `means`
/// `[N, 3]` with `rotations` `[N, 4]` (w, x, y, z, of any length) and `sh` `[N, K, 3]`, seen from `eye`. Gradients
/// reach all of these, the normals and the material. Where a rotation or a normal has length 0, only ambient light is
/// left.
///
/// # Panics
/// If the shapes disagree.
pub fn shaded(
    means: Tensor<2>,
    rotations: Tensor<2>,
    sh: Tensor<3>,
    shading: &GaussianShading,
    eye: [f32; 3],
) -> Tensor<3> {
    let [n, _, _] = sh.dims();
    assert_eq!(means.dims(), [n, 3], "shaded: means are [N, 3] with N = {n}");
    assert_eq!(rotations.dims(), [n, 4], "shaded: rotations are [N, 4] with N = {n}");
    assert_eq!(shading.normals.dims(), [n, 3], "shaded: normals are [N, 3] with N = {n}");
    assert_eq!(shading.material.dims(), [MATERIAL], "shaded: a material is [3]");
    let device = means.device();
    if !is_gpu(&device) {
        return ops::fused(means, rotations, sh, shading, eye);
    }
    composed(means, rotations, sh, shading, eye)
}

/// Whether the device is a GPU, where tensor operations are used.
#[cfg(feature = "cube")]
fn is_gpu(device: &Device) -> bool {
    crate::is_gpu(device)
}

/// Always false: without the feature `cube` there are no GPUs.
#[cfg(not(feature = "cube"))]
fn is_gpu(_: &Device) -> bool {
    false
}

/// [`shaded`] by tensor operations.
fn composed(
    means: Tensor<2>,
    rotations: Tensor<2>,
    sh: Tensor<3>,
    shading: &GaussianShading,
    eye: [f32; 3],
) -> Tensor<3> {
    let [n, k, _] = sh.dims();
    let device = means.device();
    let place = |v: [f32; 3]| Tensor::<2>::from_data(TensorData::new(v.to_vec(), [1, 3]), &device);
    let normals = turned(shading.normals.clone(), rotations);
    let to_eye = place(eye) - means;
    let (diffuse, highlight) = match shading.light {
        Light::Head => {
            let cosine = cosine(&normals, &to_eye);
            (cosine.clone(), cosine)
        }
        Light::Far(direction) => {
            let to_light = unit(place(direction));
            (cosine(&normals, &to_light), cosine(&normals, &(unit(to_eye) + to_light)))
        }
    };
    let material = shading.material.clone().reshape([1, MATERIAL]);
    let trained = |i: usize| material.clone().slice([0..1, i..i + 1]);
    let (ambient, specular, exponent) = (sigmoid(trained(0)), trained(1).exp(), trained(2).exp());
    let glow = ambient.clone() + (ambient.neg() + 1.0) * diffuse;
    let shine = specular * (highlight.clamp_min(GRAZING).log() * exponent).exp();
    let base = sh.clone().slice([0..n, 0..1, 0..3]).reshape([n, 3]) * C0 + 0.5;
    let colour = base * glow + shine;
    let first = ((colour - 0.5) / C0).reshape([n, 1, 3]);
    if k == 1 { first } else { Tensor::cat(vec![first, sh.slice([0..n, 1..k, 0..3])], 1) }
}

/// Rotates `vectors` `[N, 3]` by quaternions `[N, 4]`, and scales them by the squared lengths of the quaternions.
fn turned(vectors: Tensor<2>, rotations: Tensor<2>) -> Tensor<2> {
    let [n, _] = vectors.dims();
    let w = rotations.clone().slice([0..n, 0..1]);
    let u = rotations.slice([0..n, 1..4]);
    let along = dot(&u, &vectors) * 2.0;
    let across = u.clone().cross(vectors.clone(), 1);
    vectors * (w.clone() * w.clone() - dot(&u, &u)) + u * along + across * (w * 2.0)
}

/// `[N, 1]`
fn dot(a: &Tensor<2>, b: &Tensor<2>) -> Tensor<2> {
    (a.clone() * b.clone()).sum_dim(1)
}

fn unit(vectors: Tensor<2>) -> Tensor<2> {
    let length = dot(&vectors, &vectors).clamp_min(MIN_SQUARE).sqrt();
    vectors / length
}

/// Returns the absolute cosines of the angles between the rows of `a` and `b` `[N, 1]`.
fn cosine(a: &Tensor<2>, b: &Tensor<2>) -> Tensor<2> {
    let lengths = dot(a, a).clamp_min(MIN_SQUARE).sqrt() * dot(b, b).clamp_min(MIN_SQUARE).sqrt();
    (dot(a, b) / lengths).abs()
}

#[cfg(all(test, feature = "flex"))]
mod tests {
    use super::*;

    #[test]
    fn tensor_operations_match_the_kernel() {
        let device = Device::flex();
        let rows = |seed: usize, width: usize| {
            let values: Vec<f32> = (0..50 * width).map(|i| ((i * 7 + seed) as f32 * 0.61).sin()).collect();
            Tensor::<2>::from_data(TensorData::new(values, [50, width]), &device)
        };
        let material = Material { ambient: 0.2, specular: 0.4, exponent: 8.0 }.to_trained().to_vec();
        let material = Tensor::from_data(TensorData::new(material, [MATERIAL]), &device);
        for light in [Light::Head, Light::Far([0.5, -1.0, 0.2])] {
            let shading = GaussianShading { normals: rows(1, 3), material: material.clone(), light };
            let sh = rows(2, 12).reshape([50, 4, 3]);
            let (means, rotations, eye) = (rows(3, 3), rows(4, 4), [0.1, 3.0, -2.0]);
            let fused = ops::fused(means.clone(), rotations.clone(), sh.clone(), &shading, eye);
            let composed = composed(means, rotations, sh, &shading, eye);
            let tolerance = burn::tensor::Tolerance::<f32>::rel_abs(1e-4, 1e-4);
            fused.into_data().assert_approx_eq::<f32>(&composed.into_data(), tolerance);
        }
    }
}
